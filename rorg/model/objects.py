"""Networks and volumes of the engine, as a tree declares them, frozen."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from rorg.model.diagnostics import Where
from rorg.model.volumes import is_path

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


def keys_of(spec: Mapping[str, Any]) -> Iterator[str]:
    """All networks and named volumes that a container of this spec uses, declared or not."""
    for name in spec.get("networks") or ():
        yield subject("network", name)
    if spec.get("network_mode"):
        yield subject("network", str(spec["network_mode"]))
    for volume in spec.get("volumes") or ():
        if name := _named(volume):
            yield subject("volume", name)


def _named(volume: Any) -> str:
    """The name of a volume; empty for a path of the host, and for one without a name."""
    if isinstance(volume, Mapping):
        return str(volume.get("source") or "") if volume.get("type") == "volume" else ""
    source, colon, _ = volume.partition(":")
    return source if colon and not is_path(source) else ""
