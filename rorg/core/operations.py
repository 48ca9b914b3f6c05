"""The operations of a plan: one engine call each, one frozen class each.

A class carries what the call needs as typed fields, and what everyone else must know of it as facts: in which states
the engine takes it, what it leaves, whether it begins or ends a run. Planner, gates, `check`, status, standing, workers
and simulator decide by class and by these facts; names are only for people and for JSON. So a new operation is a class
here and a case in `engines/execute.py`, and a misspelt field is an error of the type checker.

Docker's rules for the states: a paused container cannot be started (409), only resumed; a running one cannot be removed
without force, which rorg never uses, since it would skip the service's own stop signal.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from rorg.core.digest import canonical
from rorg.model.objects import Kind
from rorg.model.units import format_seconds

ANY = frozenset[str]()
"""In whatever state the container is."""
ID = 12
"""Digits of a container's id that people read."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Operation:
    """One engine call on one container."""

    verb: ClassVar[str]
    """Its name in texts and in JSON."""
    symbol: ClassVar[str]
    """Its mark in the text of a plan."""
    states: ClassVar[frozenset[str]] = ANY
    """States of the container in which the engine takes it."""
    leaves: ClassVar[str] = ""
    """The container's state afterwards, if nothing else about it changes; empty if only a look can tell."""
    begins: ClassVar[bool] = False
    """The service becomes active by it."""
    idles: ClassVar[bool] = False
    """The service is not active afterwards: nobody can count on it."""
    ends: ClassVar[bool] = False
    """Nobody may count on the current run any more. A pause is among these: what is paused answers nobody."""
    felt: ClassVar[bool] = True
    """The program, and so its hardware, may feel it: an interlock holds it back."""
    optional: ClassVar[bool] = False
    """The rest of the chain does not need it: if it must wait, the rest goes on."""
    brings_up: ClassVar[bool] = False
    """One of the calls that lead an idle service to activity: urgent while a live request waits for that."""

    container: str = ""
    """Id of the container; empty for the one that an earlier operation of the chain creates."""

    def details(self) -> tuple[str, ...]:
        """What the call does beyond its name, in the canonical text of a plan. No values of the environment."""
        return ()

    @property
    def attempted(self) -> str:
        """What tells attempts on the same container apart: the same one three times in vain is a stall."""
        return ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Create(Operation):
    """Make a container and do not start it."""

    verb, symbol = "create", "+"
    felt, brings_up = False, True

    name: str
    spec: Mapping[str, Any]
    """What is sent to the engine."""
    labels: Mapping[str, str]
    digest: str
    """Of the declared spec: a different one is a new attempt, with no back-off from the last."""
    before: str = ""
    """Id of an older container of the service, whose unnamed volumes it takes over."""
    defaults: Collection[str] = ()
    """Options of the spec that no manifest sets: an image's own value goes first."""

    @property
    def attempted(self) -> str:
        return self.digest

    def details(self) -> tuple[str, ...]:
        return (f"as {self.name}", *([f"volumes of {self.before[:ID]}"] if self.before else []))


@dataclass(frozen=True, slots=True, kw_only=True)
class Start(Operation):
    """Begin a new run."""

    verb, symbol = "start", ">"
    states = frozenset({"created", "exited"})
    begins = brings_up = True

    trial: str = ""
    """The edition that this start tries; empty if it is no trial (see rollout.py)."""
    counts_on: Mapping[str, str] = field(default_factory=dict)
    """Needs whose restart restarts this run too -> their incarnation now."""
    content: Mapping[str, str] | None = None
    """Digests of what it mounts from the tree, as it reads them; None if it mounts nothing of it."""

    def details(self) -> tuple[str, ...]:
        return (
            *(["on trial"] if self.trial else []),
            *([f"counts on {', '.join(self.counts_on)}"] if self.counts_on else []),
            *([f"reads {', '.join(self.content)}"] if self.content else []),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Resume(Operation):
    """Let a paused run go on."""

    verb, symbol = "resume", "="
    states, leaves = frozenset({"paused"}), "running"
    begins = brings_up = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Pause(Operation):
    """Freeze a run: it keeps its memory and connections, and takes no CPU."""

    verb, symbol = "pause", '"'
    states, leaves = frozenset({"running", "restarting"}), "paused"
    idles = ends = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop(Operation):
    """End a run: `signal`, then SIGTERM after `grace` seconds, then SIGKILL."""

    verb, symbol = "stop", "#"
    states = frozenset({"running", "restarting", "paused"})
    idles = ends = True

    signal: str
    grace: float
    incarnation: str
    """The run that it ends: from now on its end is rorg's doing, no crash."""

    def details(self) -> tuple[str, ...]:
        return (self.signal, format_seconds(self.grace))


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal(Operation):
    """Tell a running program that its files changed."""

    verb, symbol = "signal", "~"
    states = frozenset({"running"})
    optional = True

    signal: str
    content: Mapping[str, str]
    """Digests of what it reads again."""
    incarnation: str

    def details(self) -> tuple[str, ...]:
        return (self.signal,)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rename(Operation):
    """Give a container another name."""

    verb, symbol = "rename", "~"
    felt, optional, brings_up = False, True, True

    name: str

    def details(self) -> tuple[str, ...]:
        return (f"to {self.name}",)


@dataclass(frozen=True, slots=True, kw_only=True)
class Update(Operation):
    """Set live options in place, without ending the run."""

    verb, symbol = "update", "~"
    optional = True

    options: Mapping[str, Any]

    @property
    def attempted(self) -> str:
        return canonical(self.options)

    def details(self) -> tuple[str, ...]:
        return tuple(f"{option}={value}" for option, value in sorted(self.options.items()))


@dataclass(frozen=True, slots=True, kw_only=True)
class Remove(Operation):
    """Take a container away that does not run."""

    verb, symbol = "remove", "-"
    states = frozenset({"created", "exited", "dead"})
    ends = True

    volumes: bool = False
    """With its unnamed volumes, since nobody will look for them again."""
    last_words: bool = False
    """It failed: the last lines of its log go into the journal first."""

    def details(self) -> tuple[str, ...]:
        return (
            *(["with unnamed volumes"] if self.volumes else []),
            *(["its last words are kept"] if self.last_words else []),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectOperation(Operation):
    """A call on a network or a volume; no container is touched."""

    object: Kind
    name: str


@dataclass(frozen=True, slots=True, kw_only=True)
class CreateObject(ObjectOperation):
    """Make a network or a volume."""

    verb, symbol = "create", "+"

    spec: Mapping[str, Any]
    labels: Mapping[str, str]
    digest: str

    @property
    def attempted(self) -> str:
        return self.digest


@dataclass(frozen=True, slots=True, kw_only=True)
class RemoveObject(ObjectOperation):
    """Take away a network, or a volume with all its data."""

    verb, symbol = "remove", "-"


OPERATIONS: tuple[type[Operation], ...] = (Create, Update, Rename, Signal, Start, Resume, Pause, Stop, Remove)
"""On containers, in the order in which a summary counts them."""
