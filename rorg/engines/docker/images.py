"""The images of an engine: which it has, removing, saving and loading them."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import IO, Any

from rorg.engines.docker.answers import from_json
from rorg.engines.docker.client import Client
from rorg.engines.docker.errors import Refused, docker_errors
from rorg.engines.docker.release import LOCAL
from rorg.errors import EngineError
from rorg.model.image_names import plain, without_hub

LOADING = 600.0
"""Seconds for which the engine may say nothing while it unpacks a layer."""


class Images:
    """See engines.protocol.Images."""

    client: Client

    def missing_images(self, references: Collection[str]) -> set[str]:
        """By one list, and by a look at each that is not in it."""
        named: set[str] = set()
        with docker_errors("list images"):
            for row in self.client.get("/images/json") if references else ():
                named |= {plain(tag.removeprefix(LOCAL)) for tag in row.get("RepoTags") or ()}
            return {r for r in references if plain(r) not in named and not _is_there(self.client, r)}

    def images(self) -> list[dict[str, Any]]:
        with docker_errors("list images"):
            if self.client.release.podman:  # its report of disk usage has neither labels nor whole references
                rows = self.client.get("/images/json")
            else:
                rows = self.client.get("/system/df", type="image").get("Images") or ()
            return [{**row, "RepoTags": [without_hub(tag) for tag in row.get("RepoTags") or ()]} for row in rows]

    def remove_image(self, reference: str) -> None:
        with docker_errors(f"remove {reference}"):
            self.client.delete(f"/images/{reference}")

    @contextmanager
    def save_images(self, references: Collection[str]) -> Iterator[Iterator[bytes]]:
        with (
            docker_errors("save images"),
            self.client.stream("GET", "/images/get", names=tuple(references)) as stream,
        ):
            yield iter(stream.read, b"")

    def load_images(self, archive: IO[bytes]) -> int:
        what, loaded = "load images", 0
        with docker_errors(what), self.client.stream("POST", "/images/load", archive, LOADING) as stream:
            for line in stream.lines():
                told = from_json(line)
                if "error" in told:
                    raise EngineError(what, str(told["error"]), "an archive that `rorg image save` wrote")
                loaded += "Loaded image" in str(told.get("stream", ""))
        return loaded


def _is_there(client: Client, reference: str) -> bool:
    """By a digest, an id, or the beginning of an id."""
    try:
        client.get(f"/images/{reference}/json")
    except Refused as no:
        if no.status in (400, 404):
            return False
        raise
    return True
