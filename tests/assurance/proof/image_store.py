"""Images on the engine that outlives rorg: they are names and labels, made from the text of a Dockerfile."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

from rorg.errors import EngineError


@dataclass(frozen=True)
class Made:
    """An image of the engine."""

    id: str
    labels: dict[str, str]
    tags: tuple[str, ...]
    created: float
    text: str
    """Its Dockerfile."""


class ImageStore:
    """The images of one case. `users` returns the references that containers are made from."""

    def __init__(self, users: Callable[[], Collection[str]]) -> None:
        self.images: dict[str, Made] = {}
        self.users = users
        self._numbers = count(1)

    def skip(self, number: int) -> None:
        """The next images get higher numbers."""
        self._numbers = count(number + 1)

    def find(self, reference: str) -> Made | None:
        return next((i for i in self.images.values() if reference in (*i.tags, i.id)), None)

    def missing_images(self, references: Collection[str]) -> set[str]:
        return {r for r in references if self.find(r) is None}

    def listed(self) -> list[dict[str, Any]]:
        used = self.users()
        return [
            {
                "Id": i.id,
                "RepoTags": list(i.tags),
                "Labels": i.labels,
                "Created": i.created,
                "Size": 1000,
                "SharedSize": 0,
                "Containers": len([t for t in i.tags if t in used]),
            }
            for i in self.images.values()
        ]

    def build_image(self, reference: str, labels: dict[str, str], text: str) -> str:
        number = next(self._numbers)
        made = Made(f"sha256:{number:064x}", labels, (), float(number), text)
        self.images[made.id] = made
        self.tag_image(made.id, reference)
        return made.id

    def tag_image(self, reference: str, also: str) -> None:
        for image in [i for i in self.images.values() if also in i.tags]:
            self.images[image.id] = replace(image, tags=tuple(t for t in image.tags if t != also))
        target = self.find(reference)
        if target is None:
            raise EngineError(f"tag {reference}", "no such image", kind="gone")
        self.images[target.id] = replace(target, tags=(*target.tags, also))

    def remove_image(self, reference: str) -> None:
        target = self.find(reference)
        if target is None:
            raise EngineError(f"remove {reference}", "no such image", kind="gone")
        if reference in self.users():
            raise EngineError(f"remove {reference}", "a container is made from it", kind="conflict")
        left = tuple(t for t in target.tags if t != reference)
        if left:
            self.images[target.id] = replace(target, tags=left)
        else:
            del self.images[target.id]

    def saved(self, references: Collection[str]) -> bytes:
        found = [i for r in references if (i := self.find(r))]
        return json.dumps([[i.id, i.tags, i.text] for i in found]).encode()
