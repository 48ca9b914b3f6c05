"""Networks and volumes found on the engine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from rorg.model.objects import Kind, subject


@dataclass(frozen=True, slots=True)
class FoundObject:
    """A network or volume on the engine."""

    kind: Kind
    called: str
    """Its name on the engine."""
    id: str = ""
    """A network recreated with the same name has another id. Volumes have no id besides their name."""
    owner: str = ""
    """The label rorg.io/owner; "" if rorg did not create it."""
    name: str = ""
    """Its name in the manifest."""
    digest: str = ""
    """The label rorg.io/spec: digest of what it was made from."""
    declared: str = ""
    """The label rorg.io/declared: JSON of the declared options, to show what changed."""

    @property
    def key(self) -> str:
        return subject(self.kind, self.called)


@dataclass(frozen=True, slots=True)
class FoundObjects:
    """All networks and volumes owned by rorg, and those with the name of a declared one."""

    found: Mapping[str, FoundObject] = field(default_factory=dict)
    asked: frozenset[str] = frozenset()
    """Keys that were looked up. Only for these, a missing entry in `found` means that the object does not exist."""
    complete: bool = False
    """Whether the engine has answered; until then nothing is known."""
    error: str = ""
    """Why it could not answer."""
