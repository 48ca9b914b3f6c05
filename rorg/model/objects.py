"""Networks and volumes of a tree, frozen, and which of them a container uses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from rorg.model.diagnostics import Where
from rorg.model.volumes import is_path, read_mount

Kind = Literal["network", "volume"]
KINDS: tuple[Kind, ...] = ("network", "volume")


@dataclass(frozen=True, slots=True)
class EngineObject:
    """A network or a volume of a tree."""

    kind: Kind
    name: str
    """What services write."""
    called: str
    """Its name in the engine."""
    spec: Mapping[str, Any] = field(default_factory=dict)
    """The declared options under Compose's names, in plain JSON values. Exactly this is sent to the engine and
    digested."""
    external: bool = False
    """rorg neither creates nor removes it."""
    description: str = ""
    labels: Mapping[str, str] = field(default_factory=dict)
    """Labels of the manifest; those of the object are in its spec."""
    where: Where = Where("")

    @property
    def subject(self) -> str:
        """Its name in a plan."""
        return subject(self.kind, self.name)

    @property
    def key(self) -> str:
        """Identifies it in the engine: names are unique within a kind."""
        return subject(self.kind, self.called)


def subject(kind: str, name: str) -> str:
    """The name of a network or volume in a plan; no service can have such a name."""
    return f"{kind}/{name}"


def is_object(name: str) -> bool:
    """Whether a subject of a plan is a network or a volume rather than a service."""
    return "/" in name


def keys_of(spec: Mapping[str, Any]) -> Iterator[str]:
    """All networks and named volumes that a container with this spec uses, declared or not."""
    for name in spec.get("networks") or ():
        yield subject("network", name)
    if spec.get("network_mode"):
        yield subject("network", str(spec["network_mode"]))
    for volume in spec.get("volumes") or ():
        source = read_mount(volume).source
        if source and not is_path(source):
            yield subject("volume", source)
