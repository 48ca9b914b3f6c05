"""What helps a person at a desk: importing, Compose files, simulation. The robot needs none of it."""
