"""What others declare (Compose files, units of systemd, launch files) as texts of manifests. Writes nothing itself."""
