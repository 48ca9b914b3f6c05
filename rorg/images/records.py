"""Records what was built, and which images the last revisions used: `images.json` of the state directory."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from rorg.store.files import locked, write_atomic
from rorg.store.state_dir import read_json

NAME = "images.json"
LOCK = ".images.lock"
KEPT = 5
"""Revisions whose images are kept, unless the Policy says otherwise."""
MOST = 100
"""Revisions that are recorded."""


@dataclass(frozen=True, slots=True)
class Built:
    """An image that was built, imported or loaded."""

    name: str
    reference: str
    id: str = ""
    """The engine's id."""
    at: str = ""
    """Time in ISO 8601, UTC."""
    bases: Mapping[str, str] = field(default_factory=dict)
    """Base -> its reference or digest at that time."""

    @classmethod
    def read(cls, entry: Any) -> Built:
        """A record from a file. Raises TypeError, ValueError or AttributeError if it is not valid."""
        record = cls(**{**entry, "bases": dict(entry.get("bases", {}))})
        texts = (record.name, record.reference, record.id, record.at, *record.bases, *record.bases.values())
        if not all(isinstance(text, str) for text in texts):
            raise TypeError("a record does not consist of texts")
        return record


class Records:
    """The records of one state directory. A missing or unreadable file counts as empty: an image is then found by the
    reference that its identity gives."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.path = folder, folder / NAME
        self._read: tuple[Any, dict[str, Any]] = None, {}

    def built(self) -> dict[str, Built]:
        """Identity -> its last build."""
        builds = {}
        for identity, entry in _entries(self._content()).items():
            try:
                builds[identity] = Built.read(entry)
            except (TypeError, ValueError, AttributeError):
                continue
        return builds

    def revisions(self) -> list[list[str]]:
        """References that each state of the manifests used, latest first."""
        revisions = self._content().get("revisions")
        entries = revisions if isinstance(revisions, list) else []
        return [[str(reference) for reference in entry] for entry in entries if isinstance(entry, list)]

    def note(self, built: Mapping[str, Built]) -> None:
        """Records builds, by identity. Raises OSError."""
        if built:
            self._change(lambda content: {"built": {**_entries(content), **{i: asdict(b) for i, b in built.items()}}})

    def use(self, references: Iterable[str]) -> None:
        """Records that the current state of the manifests uses these. Raises OSError."""
        used = sorted(set(references))
        if used and self.revisions()[:1] != [used]:
            self._change(lambda _: {"revisions": [used, *(r for r in self.revisions() if r != used)][:MOST]})

    def forget(self, references: Iterable[str]) -> None:
        """Records that these were removed from the machine. Raises OSError."""
        gone = set(references)
        if gone:
            self._change(
                lambda content: {
                    "built": {i: e for i, e in _entries(content).items() if _mapping(e).get("reference") not in gone}
                }
            )

    def _change(self, edit: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
        with locked(self.folder / LOCK):
            self._read = None, {}
            content = self._content()
            write_atomic(self.path, json.dumps({**content, **edit(content)}) + "\n")
            self._read = None, {}

    @property
    def stamp(self) -> tuple[int, ...]:
        """Changes whenever the file does; empty if there is none."""
        try:
            facts = self.path.stat()
        except OSError:
            return ()
        return facts.st_mtime_ns, facts.st_size, facts.st_ino

    def _content(self) -> dict[str, Any]:
        stamp = self.stamp
        if self._read[0] != stamp:
            self._read = stamp, _mapping(read_json(self.path))
        return self._read[1]


def _entries(content: Mapping[str, Any]) -> dict[str, Any]:
    return _mapping(content.get("built"))


def _mapping(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}
