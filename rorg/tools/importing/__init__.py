"""Turns what others declare (Compose files, systemd units, launch files) into manifests."""
