"""Manifests: YAML with positions, models, rendering of profiles and drivers, schemas. Reads files, changes nothing."""
