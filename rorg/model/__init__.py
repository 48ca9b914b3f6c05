"""Frozen values that every room uses: no YAML, no pydantic, no files, no clock."""
