"""Frozen values that every room speaks of: no YAML, no pydantic, no files, no clock."""
