"""Editions of a service, one after the other."""

from __future__ import annotations


def edition(word: str, **more) -> dict:
    return {"arm": {"always_on": True, "container": {"environment": {"EDITION": word}}, **more}}
