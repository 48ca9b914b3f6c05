"""Docker Swarm as an engine: services that may run on any of its nodes."""
