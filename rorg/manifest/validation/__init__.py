"""Checks of a robot as a whole, whose manifests may each be valid: one file per family of checks."""
