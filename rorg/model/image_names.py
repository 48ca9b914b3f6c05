"""References of images, as people and engines write them: which ones mean the same, and which one an identity gives."""

from __future__ import annotations

from collections.abc import Collection

HUB = ("docker.io/library/", "docker.io/", "index.docker.io/library/", "index.docker.io/")
"""What an engine puts before a name that says no registry."""
SHORT = 12
"""Digits of an identity in a tag."""


def plain(reference: str) -> str:
    """The shortest form that means the same to an engine: "docker.io/library/base:latest" is "base"."""
    for prefix in HUB:
        if reference.startswith(prefix):
            reference = reference.removeprefix(prefix)
            break
    return reference.removesuffix(":latest")


def declared(reference: str, names: Collection[str]) -> str:
    """Which of these Images a reference means; empty where it is none of them."""
    found = plain(reference)
    return found if found in names else ""


def with_identity(name: str, identity: str) -> str:
    """The reference that means this content for ever: "base" is "base:0123456789ab", "lab/base:2" is
    "lab/base:2-0123456789ab"."""
    short = identity[:SHORT]
    return f"{name}-{short}" if ":" in name.rpartition("/")[2] else f"{name}:{short}"
