"""Builds, pulls and imports images, and decides which reference names which content."""
