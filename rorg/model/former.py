"""What the last good tree declared and the current one does not: it must survive a restart of rorg."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from rorg.model.catalog import Catalog, Group, Service


@dataclass(frozen=True, slots=True)
class Former:
    """A service or a group as it was declared last."""

    what: Service | Group
    needed_by: tuple[str, ...] = ()
    groups: tuple[str, ...] = ()
    """Those that named it."""
    withheld: str = ""
    """Why its removal waits for a person's confirmation; empty if it does not. Once set, it stays until then."""


@dataclass(frozen=True, slots=True)
class Kept:
    """What a pass hands to the next one."""

    catalog: Catalog | None = None
    """The last good tree that was looked at."""
    former: Mapping[str, Former] = field(default_factory=dict)
    merged: tuple[Catalog, Mapping[str, Former], Any] | None = None
    """The Desired of a tree merged with what is withheld, which takes long to compute; not stored."""
