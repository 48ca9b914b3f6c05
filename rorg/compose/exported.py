"""What comes of writing a robot as a Compose file: the document, what stands beside it, and what is not in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Note:
    """Something that a Compose file cannot say, or says in other words."""

    service: str
    """Empty for what is said of the whole robot."""
    field: str
    """Of the manifest: `spec.idle`, `spec.container.cpuset_mems`."""
    text: str
    """What becomes of it."""
    lost: bool = True
    """It is not in the Compose file at all; False where other words stand for it."""

    def as_json(self) -> dict[str, Any]:
        """For programs."""
        carried = "not carried" if self.lost else "translated"
        return {"service": self.service, "field": self.field, "carried": carried, "message": self.text}

    def __str__(self) -> str:
        return f"{self.field}: {self.text}"


@dataclass(frozen=True, slots=True)
class Exported:
    """A robot as a Compose file."""

    document: Mapping[str, Any]
    """As Compose takes it, but for `$` in texts, which stands once."""
    notes: tuple[Note, ...] = ()
    files: Mapping[str, str] = field(default_factory=dict)
    """Name -> text of what the document names beside it. Those that end in .env hold secrets."""
    descriptions: Mapping[str, str] = field(default_factory=dict)
    """Service -> its description."""
