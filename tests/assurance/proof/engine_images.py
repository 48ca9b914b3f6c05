"""Images on the engine that outlives rorg, as the killed rorg sees them."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator
from typing import IO, Any

from proof.engine_link import RemoteEngine

from rorg.errors import EngineError
from rorg.images.order import Order, Say


class RemoteImages(RemoteEngine):
    """The same engine with images, by whose name rorg knows that references are made from contents."""

    name = "docker"

    def missing_images(self, references: Collection[str]) -> set[str]:
        return self._call("missing_images", tuple(references))

    def images(self) -> list[dict[str, Any]]:
        return self._call("images")

    def remove_image(self, reference: str) -> None:
        self._call("remove_image", reference)

    @contextlib.contextmanager
    def save_images(self, references: Collection[str]) -> Iterator[Iterator[bytes]]:
        yield iter([self._call("save_images", tuple(references))])

    def load_images(self, archive: IO[bytes]) -> int:
        raise EngineError("load images", "the harness does not load any")


class RemoteBuilder:
    """Makes images on it. See Builder."""

    def __init__(self, engine: RemoteImages) -> None:
        self.engine = engine

    def there(self, references: Collection[str]) -> set[str]:
        return set(references) - self.engine.missing_images(references)

    def pull(self, reference: str, say: Say) -> None:
        self.engine._call("build_image", reference, {}, "")

    def build(self, order: Order, say: Say) -> str:
        assert order.image
        with open(f"{order.image.context}/Dockerfile", encoding="utf-8") as file:
            text = file.read()
        for line in text.splitlines():
            say(line, step=True)
        return str(self.engine._call("build_image", order.reference, dict(order.labels), text))

    def load(self, order: Order, say: Say) -> str:
        raise EngineError(f"import {order.name}", "the harness does not import any")

    def tag(self, reference: str, also: str) -> None:
        self.engine._call("tag_image", reference, also)

    def remove(self, references: Collection[str]) -> None:
        for reference in references:
            self.engine.remove_image(reference)

    def digest(self, reference: str) -> str:
        return reference

    def cancel(self) -> None:
        """Nothing takes long."""

    def close(self) -> None:
        """Nothing is open."""
