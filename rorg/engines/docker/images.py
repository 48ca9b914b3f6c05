"""Which images an engine has."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from rorg.engines.docker.client import Client
from rorg.engines.docker.errors import Refused
from rorg.model.image_names import plain

LOCAL = "localhost/"
"""What Podman puts before a name that says no registry, and was made here."""


def missing_images(client: Client, references: Collection[str]) -> set[str]:
    """Those of these that the engine does not have: by one list, and by a look at each that it does not name."""
    named: set[str] = set()
    for row in client.get("/images/json") if references else ():
        named |= {plain(tag.removeprefix(LOCAL)) for tag in row.get("RepoTags") or ()}
    return {r for r in references if plain(r) not in named and not _is_there(client, r)}


def _is_there(client: Client, reference: str) -> bool:
    """By a digest, an id, or the beginning of one."""
    try:
        client.get(f"/images/{reference}/json")
    except Refused as no:
        if no.status in (400, 404):
            return False
        raise
    return True


def disk_use(client: Client) -> list[dict[str, Any]]:
    """All images with what they take on the disk: Size, SharedSize (bytes), and Containers, the number of those that
    are made from them. Takes a while where there are many."""
    return list(client.get("/system/df", type="image").get("Images") or ())


def remove_image(client: Client, reference: str) -> None:
    """Takes a reference away, and the image with the last one. Raises Refused where something is made from it."""
    client.delete(f"/images/{reference}")
