"""What the last good tree declared and the tree of now does not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from rorg.core.desired import Desired
from rorg.model.catalog import Catalog, Group, Service


@dataclass(frozen=True, slots=True)
class Former:
    """A service or a group as it was declared last."""

    what: Service | Group
    needed_by: tuple[str, ...] = ()
    groups: tuple[str, ...] = ()
    """Those that named it."""
    withheld: str = ""
    """Why its removal waits for a person's word; empty while it does not. Once said, it holds until that word."""


@dataclass(frozen=True, slots=True)
class Kept:
    """What a pass passes on to the next one."""

    catalog: Catalog | None = None
    """The last good tree that was looked at."""
    former: Mapping[str, Former] = field(default_factory=dict)
    merged: tuple[Catalog, Mapping[str, Former], Desired] | None = None
    """What was desired with a tree and those that are withheld, which takes long to find."""
