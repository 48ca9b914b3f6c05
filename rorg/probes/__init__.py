"""Asks whether services are ready, alive, or may be touched."""
