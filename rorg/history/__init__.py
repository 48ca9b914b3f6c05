"""What has happened to this robot: events, revisions of its manifests, and the memory that survives a restart of
rorg."""
