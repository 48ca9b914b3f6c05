"""Which images an engine has, and removing them."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from rorg.engines.docker.client import Client
from rorg.engines.docker.errors import Refused
from rorg.model.image_names import plain

LOCAL = "localhost/"
"""Podman's prefix of names that were made here and name no registry."""


def missing_images(client: Client, references: Collection[str]) -> set[str]:
    """Return those of these that the engine does not have: by one list, and by a look at each that is not in it."""
    named: set[str] = set()
    for row in client.get("/images/json") if references else ():
        named |= {plain(tag.removeprefix(LOCAL)) for tag in row.get("RepoTags") or ()}
    return {r for r in references if plain(r) not in named and not _is_there(client, r)}


def _is_there(client: Client, reference: str) -> bool:
    """By a digest, an id, or the beginning of an id."""
    try:
        client.get(f"/images/{reference}/json")
    except Refused as no:
        if no.status in (400, 404):
            return False
        raise
    return True


def disk_use(client: Client) -> list[dict[str, Any]]:
    """All images with their use of the disk: Size, SharedSize (bytes), and Containers, the number of containers made
    from them. Takes long if there are many."""
    return list(client.get("/system/df", type="image").get("Images") or ())


def remove_image(client: Client, reference: str) -> None:
    """Remove a reference, and with the last one the image. Raises Refused if something is made from it."""
    client.delete(f"/images/{reference}")
