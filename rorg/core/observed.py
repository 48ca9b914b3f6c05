"""What the engine reports: containers, networks and volumes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field
from typing import Any, TypedDict

from rorg.core.changes import changed_items, differing
from rorg.model.objects import Kind, subject
from rorg.model.units import stamp

LABEL_OWNER = "rorg.io/owner"
LABEL_STATE = "rorg.io/state"
"""The owner's state directory, for people; no decision depends on it."""
LABEL_SERVICE = "rorg.io/service"
LABEL_SPEC = "rorg.io/spec"
LABEL_DECLARED = "rorg.io/declared"
LABEL_RULES = "rorg.io/rules"
LABEL_PREVIOUS = "rorg.io/previous"
LABEL_DEVICES = "rorg.io/devices"
LABEL_JOINED = "rorg.io/joined"
SERVICE = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,127}")
"""Names that a service may have, in any version of rorg."""


class Labelled(TypedDict):
    """The fields of Container that come from its labels."""

    service: str
    digest: str
    declared: str
    rules: str
    previous: str
    devices: str
    joined: str


def from_labels(labels: Mapping[str, str]) -> Labelled:
    """Return what rorg's labels say about a container. A container whose label names no service is left alone."""
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


PROCESS_GONE = "the engine calls it running, but its process has ended"
ASLEEP = frozenset({"inactive", "paused"})
"""States of a container whose run goes on although nothing can rely on it."""


@dataclass(frozen=True, slots=True)
class Container:
    """One container with rorg's owner label."""

    id: str
    name: str
    service: str
    state: str
    """created, running, paused, exited, restarting, removing or dead, as in Docker; inactive if it runs and one of its
    managed nodes is not active (ROS 2)."""
    started_at: str = ""
    """When it last started, by the engine's clock, ISO 8601 in UTC; "" if it never did."""
    exit_code: int | None = None
    """Of its last run; while it is `restarting`, of the run that the engine is about to follow by another one."""
    oom_killed: bool = False
    error: str = ""
    digest: str = ""
    """The label rorg.io/spec: digest of what it was created from."""
    declared: str = ""
    """The label rorg.io/declared: JSON of the declared options, to show what changed."""
    rules: str = ""
    """The label rorg.io/rules: what still counts after its manifest is gone."""
    previous: str = ""
    """The label rorg.io/previous: id of the container it replaces, which is kept until this one is proven."""
    devices: str = ""
    """The label rorg.io/devices: JSON of the device nodes it was given."""
    joined: str = ""
    """The label rorg.io/joined: JSON, services it is joined to -> id of the container."""
    created_at: str = ""
    """When it was created, in the form of started_at."""
    start_number: int = 0
    """Which of the starts that this rorg has seen began its last run; 0 if it was there before. Times do not tell that:
    the clock may have been set between two starts."""
    live: Mapping[str, Any] = field(default_factory=dict)
    """Present values of the options that the engine can change in place."""
    pid: int = 0
    brief: bool = False
    """The engine listed it with its state only, so it is not known which run this is."""
    vanished: bool = False
    """The engine calls it running although its process has ended."""
    signalled: bool = False
    """Someone else than rorg sent this run a signal to end it."""
    health: str = ""
    """Result of the engine's own health check: starting, healthy, unhealthy; "" without one."""
    stop_signal: str = ""
    """The signal that the engine stops it with, as declared or from its image; "" if not known."""
    image: str = ""
    """Id of its image; "" if there is none or it is not known."""
    node: str = ""
    """The node of the Swarm that runs it; "" for an engine of one machine."""
    address: str = ""
    """Where its ports are, if the engine is not on this machine; "" if that is not known."""
    networks: Mapping[str, str] = field(default_factory=dict)
    """Engine's name of each joined network -> the network's id, "" before the first start."""

    @property
    def incarnation(self) -> str:
        """One run of this container: its id and start time. Another start is another incarnation."""
        return f"{self.id[:12]}@{self.started_at}"

    @property
    def ended(self) -> bool:
        """Whether its program has ended, even if the engine is about to start it again or does not know."""
        return self.state == "exited" or self.vanished or (self.state == "restarting" and self.exit_code is not None)

    @property
    def killed(self) -> bool:
        """Whether a signal from outside ended it, by its exit code: SIGKILL or SIGTERM, and not for want of memory."""
        return self.exit_code in (137, 143) and not self.oom_killed

    @property
    def lost(self) -> bool:
        """Whether nothing can be done with it any more: the engine removes it, or could not remove it whole."""
        return self.state in ("removing", "dead")

    @property
    def active(self) -> bool:
        """Whether it uses the CPU, or may at any moment."""
        return self.state in ("running", "restarting")

    @property
    def alive(self) -> bool:
        """Whether its run goes on."""
        return self.active or self.asleep

    @property
    def asleep(self) -> bool:
        """Whether its run goes on, but nothing can rely on it: it is paused, or a managed node is not active."""
        return self.state in ASLEEP


@dataclass(frozen=True, slots=True)
class Silence:
    """The engine does not answer pings, so nothing is known about what runs."""

    engine: str
    """Its address."""
    since: float
    """When the first unanswered ping was sent, seconds since the epoch."""
    why: str

    def __str__(self) -> str:
        at = stamp(self.since)[11:19]
        return f"the engine at {self.engine} has not answered since {at} UTC: {self.why}"


@dataclass(frozen=True, slots=True)
class Observed:
    """All containers of rorg's. While `complete` is False the engine does not answer: the list shows what was seen
    last, and a missing container proves nothing."""

    containers: tuple[Container, ...] = ()
    complete: bool = True
    error: str = ""
    objects: FoundObjects | None = None
    """Networks and volumes; None if the engine has none."""
    looked: Mapping[str, float] = field(default_factory=dict, compare=False)
    """Container id -> when the last answered look at it began, by the loop's clock. A verdict about a moment needs a
    look that began after it."""
    silence: Silence | None = None
    """Set while the engine does not answer pings; `complete` is False then."""
    elsewhere: Mapping[str, Container] = field(default_factory=dict)
    """Service of another machine -> a container that stands for the one there, so that its state and run can be looked
    up. It is in none of the lists."""
    _by_service: dict[str, list[Container]] | None = field(default=None, init=False, compare=False, repr=False)
    _undeclared: tuple[Mapping[str, object], Set[str]] | None = field(
        default=None, init=False, compare=False, repr=False
    )

    def by_service(self) -> dict[str, list[Container]]:
        """Return the containers of each service: alive ones first, then the last started, and lost ones last.
        Containers whose label names no service are left out. The result is cached, because a pass asks often."""
        if self._by_service is None:
            object.__setattr__(self, "_by_service", _sorted(self.containers))
        return self._by_service  # type: ignore[return-value]

    def of(self, service: str) -> Sequence[Container]:
        """Return the containers of one service."""
        found = self.by_service().get(service, ())
        return (self.elsewhere[service],) if not found and service in self.elsewhere else found

    def current(self, service: str) -> Container | None:
        """Return the container by which a service is active, or else the last started one."""
        return next(iter(self.of(service)), None)

    def undeclared(self, declared: Mapping[str, object]) -> Set[str]:
        """Return services with a container that are not declared. The last result is cached, because a pass asks
        often."""
        if self._undeclared is None or self._undeclared[0] is not declared:
            there = self.by_service().keys()
            found: Set[str] = set() if there <= declared.keys() else there - declared.keys()
            object.__setattr__(self, "_undeclared", (declared, found))
        return self._undeclared[1]  # type: ignore[index]

    def since(self, before: Observed) -> set[str]:
        """Return services whose containers changed, and take over the sorting of all others."""
        if before is self:
            return set()
        moved = differing(before.elsewhere, self.elsewhere)
        went, came = changed_items(before.containers, self.containers)
        changed = {c.service for c in (*went, *came) if c.service}
        if self._by_service is None:
            by_service, gone = {**before.by_service()}, {c.id for c in went}
            there = [c for name in changed for c in by_service.get(name, ()) if c.id not in gone]
            by_service |= (found := _sorted([*there, *came]))
            for name in changed - found.keys():
                by_service.pop(name, None)
            object.__setattr__(self, "_by_service", by_service)
            if before._undeclared is not None:
                declared, undeclared = before._undeclared
                here = {n for n in changed if n in self.by_service() and n not in declared}
                object.__setattr__(self, "_undeclared", (declared, (undeclared - changed) | here))
        return changed | moved


def _sorted(containers: Iterable[Container]) -> dict[str, list[Container]]:
    by_service: dict[str, list[Container]] = {}
    for container in containers:
        if container.service:
            by_service.setdefault(container.service, []).append(container)
    return {name: own if len(own) == 1 else _last_started_first(own) for name, own in by_service.items()}


def _last_started_first(containers: list[Container]) -> list[Container]:
    """Sort the containers of a service. If this rorg has not seen the starts, a container that replaces another one
    started after it. Times only put containers in order that do not replace each other."""
    known = {c.id: c for c in containers}

    def generation(container: Container) -> int:
        number = 0
        while (previous := known.get(container.previous)) is not None and number < len(known):
            container, number = previous, number + 1
        return number

    return sorted(
        containers,
        key=lambda c: (c.alive, not c.lost, c.started_at != "", c.start_number, generation(c), c.started_at, c.id),
        reverse=True,
    )


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
