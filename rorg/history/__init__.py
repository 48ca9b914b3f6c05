"""The history of this robot: events, revisions of its manifests, and the memory that survives a restart of
rorg."""
