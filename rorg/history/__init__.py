"""What has happened to this robot: events, revisions of its manifests, and what outlives a restart of rorg."""
