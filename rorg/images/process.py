"""Images on the process engine, which has none: an image just adds folders to PATH."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from pathlib import Path

from rorg.images.order import Order, Say
from rorg.store.files import locked, write_atomic
from rorg.store.state_dir import read_json

LOCK = ".process-images.lock"


class ProcessBuilder:
    """Notes, by reference, the folders with the programs of an image: its context and those of its parents. They come
    first in PATH. See Builder."""

    def __init__(self, state: Path) -> None:
        self._path = state / "process-images.json"

    def there(self, references: Collection[str]) -> set[str]:
        return set(references) & self._noted().keys()

    def pull(self, reference: str, say: Say) -> None:
        self._note(reference, [])

    def load(self, order: Order, say: Say) -> str:
        return self._note(order.reference, [])

    def build(self, order: Order, say: Say) -> str:
        assert order.image
        noted = self._noted()
        below = [folder for reference in order.below for folder in noted.get(reference, ())]
        return self._note(order.reference, [str(order.image.context), *dict.fromkeys(below)])

    def tag(self, reference: str, also: str) -> None:
        self._note(also, self._noted()[reference])

    def remove(self, references: Collection[str]) -> None:
        with locked(self._path.with_name(LOCK)):
            left = {name: folders for name, folders in self._noted().items() if name not in references}
            write_atomic(self._path, json.dumps(left), durable=False)

    def digest(self, reference: str) -> str:
        return reference

    def cancel(self) -> None:
        """Nothing takes long."""

    def close(self) -> None:
        """Nothing is open."""

    def _noted(self) -> dict[str, list[str]]:
        return read_json(self._path) or {}

    def _note(self, reference: str, folders: Sequence[str]) -> str:
        """Adds an entry under a lock, because several builders and commands write the file."""
        with locked(self._path.with_name(LOCK)):
            write_atomic(self._path, json.dumps({**self._noted(), reference: list(folders)}), durable=False)
        return reference
