"""Networks and volumes as they are found on the engine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from rorg.model.objects import Kind, subject


@dataclass(frozen=True, slots=True)
class FoundObject:
    """A network or volume that is there."""

    kind: Kind
    called: str
    """The engine's name."""
    id: str = ""
    """Another one of the same name has another id; a volume has none but its name."""
    owner: str = ""
    """The label rorg.io/owner; empty where rorg did not make it."""
    name: str = ""
    """What its manifest was called."""
    digest: str = ""
    """The label rorg.io/spec: the digest of what it was made from."""
    declared: str = ""
    """The label rorg.io/declared: JSON of the declared options, for showing what changed."""

    @property
    def key(self) -> str:
        return subject(self.kind, self.called)


@dataclass(frozen=True, slots=True)
class FoundObjects:
    """What was found, by key: all of ours, and whatever is called as one that is declared."""

    found: Mapping[str, FoundObject] = field(default_factory=dict)
    asked: frozenset[str] = frozenset()
    """Keys that were looked for; nothing may be concluded of others that are not in `found`."""
    complete: bool = False
    """The engine has answered; until then nothing is known at all."""
    error: str = ""
    """Why it could not say."""
