"""Runs services: the Engine protocol, its engines, their observer and their caller. No decisions here."""
