"""What the engine says is there."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypedDict

from rorg.core.changes import changed_items
from rorg.core.found_objects import FoundObjects
from rorg.model.units import stamp

LABEL_OWNER = "rorg.io/owner"
LABEL_STATE = "rorg.io/state"
"""The owner's state directory, for people; nothing is decided by it."""
LABEL_SERVICE = "rorg.io/service"
LABEL_SPEC = "rorg.io/spec"
LABEL_DECLARED = "rorg.io/declared"
LABEL_RULES = "rorg.io/rules"
LABEL_PREVIOUS = "rorg.io/previous"
LABEL_DEVICES = "rorg.io/devices"
LABEL_JOINED = "rorg.io/joined"
SERVICE = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,127}")
"""What a service may be called, in any version."""


class Labelled(TypedDict):
    """Those fields of Container that stand in its labels."""

    service: str
    digest: str
    declared: str
    rules: str
    previous: str
    devices: str
    joined: str


def from_labels(labels: Mapping[str, str]) -> Labelled:
    """What our labels say of a container. One that names no service is nobody's: it is left alone."""
    service = labels.get(LABEL_SERVICE, "")
    return {
        "service": service if SERVICE.fullmatch(service) else "",
        "digest": labels.get(LABEL_SPEC, ""),
        "declared": labels.get(LABEL_DECLARED, ""),
        "rules": labels.get(LABEL_RULES, ""),
        "previous": labels.get(LABEL_PREVIOUS, ""),
        "devices": labels.get(LABEL_DEVICES, ""),
        "joined": labels.get(LABEL_JOINED, ""),
    }


@dataclass(frozen=True, slots=True)
class Container:
    """One container that carries our owner label."""

    id: str
    name: str
    service: str
    state: str
    """created, running, paused, exited, restarting, removing or dead: the engine's words."""
    started_at: str = ""
    """When it last started, by the engine's clock, ISO 8601 in UTC; empty when it never did."""
    exit_code: int | None = None
    oom_killed: bool = False
    error: str = ""
    digest: str = ""
    """The label rorg.io/spec: the digest of what it was created from."""
    declared: str = ""
    """The label rorg.io/declared: JSON of the declared options, for showing what changed."""
    rules: str = ""
    """The label rorg.io/rules: what of its manifest still counts when no manifest declares it any more."""
    previous: str = ""
    """The label rorg.io/previous: id of the container that it takes the place of, kept until this one is proven."""
    devices: str = ""
    """The label rorg.io/devices: JSON of the nodes that it was given for its devices."""
    joined: str = ""
    """The label rorg.io/joined: JSON of the services whose containers it is joined to, each with the id of its one."""
    created_at: str = ""
    """When it was made, as started_at."""
    live: Mapping[str, Any] = field(default_factory=dict)
    """Options that the engine can change in place, as they are now."""
    pid: int = 0
    brief: bool = False
    """The engine told no more than what it is and its state: which run this is, is not known."""
    health: str = ""
    """What the engine's own health check says: starting, healthy, unhealthy; empty without one."""
    stop_signal: str = ""
    """What it is to be stopped with, by the engine: declared when made, or its image's; empty where not known."""
    image: str = ""
    """What the engine calls the image that it was made from (its id); empty where there are none, or not known."""
    networks: Mapping[str, str] = field(default_factory=dict)
    """The engine's name of each network that it joins -> that network's id, "" before its first start."""

    @property
    def incarnation(self) -> str:
        """One run of this container; another start is another incarnation."""
        return f"{self.id[:12]}@{self.started_at}"

    @property
    def active(self) -> bool:
        """It uses the CPU, or could at any moment."""
        return self.state in ("running", "restarting")

    @property
    def alive(self) -> bool:
        """Its incarnation goes on: running or paused."""
        return self.state in ("running", "restarting", "paused")


@dataclass(frozen=True, slots=True)
class Silence:
    """The engine does not answer pings: nothing is known of what runs."""

    engine: str
    """Its address."""
    since: float
    """When the first ping was sent that it has not answered, seconds since the epoch."""
    why: str

    def __str__(self) -> str:
        at = stamp(self.since)[11:19]
        return f"the engine at {self.engine} has not answered since {at} UTC: {self.why}"


@dataclass(frozen=True, slots=True)
class Observed:
    """All containers of ours. `complete` is False while the engine does not answer: then nothing may be concluded
    from what is not in the list, and the list shows what was seen last."""

    containers: tuple[Container, ...] = ()
    complete: bool = True
    error: str = ""
    objects: FoundObjects | None = None
    """Networks and volumes; None where the engine has none to be made."""
    looked: Mapping[str, float] = field(default_factory=dict, compare=False)
    """Container id -> when the last look at it began that the engine answered, by the loop's clock. A verdict on a run
    needs a look that began after the moment of which it speaks."""
    silence: Silence | None = None
    """Set while the engine does not answer pings; then it is not complete."""
    _by_service: dict[str, list[Container]] | None = field(default=None, init=False, compare=False, repr=False)

    def by_service(self) -> dict[str, list[Container]]:
        """Containers of each service: alive ones first, then the last started. Found once, asked often in a pass. What
        carries our label and names no service is not among them, whoever made it so."""
        if self._by_service is None:
            object.__setattr__(self, "_by_service", _sorted(self.containers))
        return self._by_service  # type: ignore[return-value]

    def since(self, before: Observed) -> set[str]:
        """Services whose containers are others, or otherwise, than before. What is the same needs no sorting again."""
        if before is self:
            return set()
        changed = {c.service for c in changed_items(before.containers, self.containers) if c.service}
        if self._by_service is None:
            found = {**before.by_service()}
            for name in changed:
                found.pop(name, None)
            found |= _sorted(c for c in self.containers if c.service in changed) if changed else {}
            object.__setattr__(self, "_by_service", found)
        return changed


def _sorted(containers: Iterable[Container]) -> dict[str, list[Container]]:
    found: dict[str, list[Container]] = {}
    for container in sorted(containers, key=lambda c: (c.alive, c.started_at, c.id), reverse=True):
        if container.service:
            found.setdefault(container.service, []).append(container)
    return found
