"""Networks and volumes of the engine, as a tree declares them, frozen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from rorg.model.diagnostics import Where

Kind = Literal["network", "volume"]
KINDS: tuple[Kind, ...] = ("network", "volume")


@dataclass(frozen=True, slots=True)
class EngineObject:
    """A network or a volume of a tree."""

    kind: Kind
    name: str
    """What services write."""
    called: str
    """What the engine calls it."""
    spec: Mapping[str, Any] = field(default_factory=dict)
    """The declared options under Compose's names, in plain JSON values. Exactly this is sent to the engine, and exactly
    this is digested."""
    external: bool = False
    """Somebody else makes and removes it."""
    description: str = ""
    labels: Mapping[str, str] = field(default_factory=dict)
    """Of the manifest; those of the object stand in its spec."""
    where: Where = Where("")

    @property
    def subject(self) -> str:
        """What a plan calls it."""
        return subject(self.kind, self.name)

    @property
    def key(self) -> str:
        """Which one of the engine's it is: no two of a kind are called the same."""
        return subject(self.kind, self.called)


def subject(kind: str, name: str) -> str:
    """A network or volume in a plan; no service can be called so."""
    return f"{kind}/{name}"


def is_object(name: str) -> bool:
    """Whether a subject of a plan is a network or a volume, and no service."""
    return "/" in name
