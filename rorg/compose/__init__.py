"""Compose files: what they say, as values, and a robot as one."""
