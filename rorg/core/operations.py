"""The operations of a plan: one frozen class per engine call.

A class holds the call's arguments as typed fields, and facts that others need: in which states the engine accepts the
call, what it leaves behind, whether it begins or ends a run. Planner, checks, status, workers and simulator decide by
class and by these facts; names are for people and JSON. To add an operation, add a class here and a case in
`engines/execute.py`; the type checker finds misspelt fields.

Docker's rules for states: a paused container cannot be started (409), only resumed. A running one cannot be removed
without force, and rorg never uses force because it would skip the service's stop signal.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from rorg.core.digest import canonical
from rorg.model.objects import Kind
from rorg.model.units import format_seconds

ANY = frozenset[str]()
"""Accepted in any state of the container."""
ID = 12
"""Digits of a container's id that are shown to people."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Operation:
    """One engine call on one container."""

    verb: ClassVar[str]
    """Its name in texts and JSON."""
    symbol: ClassVar[str]
    """Its symbol in the text of a plan."""
    states: ClassVar[frozenset[str]] = ANY
    """States of the container in which the engine accepts it."""
    leaves: ClassVar[str] = ""
    """The container's state afterwards; "" if only another look can tell."""
    of_nodes: ClassVar[bool] = False
    """It changes managed nodes of ROS 2; the engine sees the container run all the while."""
    begins: ClassVar[bool] = False
    """The service becomes active."""
    idles: ClassVar[bool] = False
    """The service is not active afterwards, so nothing can rely on it."""
    ends: ClassVar[bool] = False
    """Nothing may rely on the current run any more. Pause is included: a paused program does not answer."""
    felt: ClassVar[bool] = True
    """The program and its hardware may notice it, so an interlock holds it back."""
    optional: ClassVar[bool] = False
    """The rest of the chain does not need it and goes on if this operation must wait."""
    brings_up: ClassVar[bool] = False
    """It brings an idle service up: urgent while a live request waits for that."""

    container: str = ""
    """Id of the container; "" for the one that an earlier operation of the chain creates."""

    def details(self) -> tuple[str, ...]:
        """Return what the call does besides its name, for the text of a plan. Never values of the environment."""
        return ()

    @property
    def engine_leaves(self) -> str:
        """The state afterwards in the engine's eyes."""
        return "running" if self.of_nodes else self.leaves

    @property
    def attempted(self) -> str:
        """Distinguishes attempts on the same container: three identical ones without effect are a stall."""
        return ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Create(Operation):
    """Create a container without starting it."""

    verb, symbol = "create", "+"
    felt, brings_up = False, True

    name: str
    spec: Mapping[str, Any]
    """The spec as sent to the engine."""
    labels: Mapping[str, str]
    digest: str
    """Of the declared spec. Another digest is a new attempt without back-off."""
    before: str = ""
    """Id of an older container of the service, whose anonymous volumes are taken over."""
    defaults: Collection[str] = ()
    """Options that no manifest sets: the image's own value has priority."""

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
    """The edition on trial; "" if this start is no trial (see rollout.py)."""
    counts_on: Mapping[str, str] = field(default_factory=dict)
    """Needs whose restart restarts this run too -> their present incarnation."""
    content: Mapping[str, str] | None = None
    """Digests of the files it mounts from the tree; None if it mounts none."""

    def details(self) -> tuple[str, ...]:
        return (
            *(["on trial"] if self.trial else []),
            *([f"counts on {', '.join(self.counts_on)}"] if self.counts_on else []),
            *([f"reads {', '.join(self.content)}"] if self.content else []),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Resume(Operation):
    """Continue a paused run."""

    verb, symbol = "resume", "="
    states, leaves = frozenset({"paused"}), "running"
    begins = brings_up = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Pause(Operation):
    """Freeze a run. It keeps its memory and connections and uses no CPU, and resumes within milliseconds."""

    verb, symbol = "pause", '"'
    states, leaves = frozenset({"running", "restarting", "inactive"}), "paused"
    idles = ends = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Activate(Operation):
    """Bring the managed nodes of ROS 2 in a running container to the state `active`, one after another, with the
    transitions that it takes: `configure`, then `activate`."""

    verb, symbol = "activate", "="
    states, leaves = frozenset({"inactive"}), "running"
    of_nodes = begins = brings_up = True

    nodes: tuple[str, ...]
    """In order of activation."""
    domain: int

    def details(self) -> tuple[str, ...]:
        return (", ".join(self.nodes),)


@dataclass(frozen=True, slots=True, kw_only=True)
class Deactivate(Operation):
    """Bring managed nodes of ROS 2 to the state `inactive`. Their processes, connections and places in the graph stay,
    so no peer blocks."""

    verb, symbol = "deactivate", '"'
    states, leaves = frozenset({"running"}), "inactive"
    of_nodes = idles = ends = True

    nodes: tuple[str, ...]
    """In order of deactivation."""
    domain: int

    def details(self) -> tuple[str, ...]:
        return (", ".join(self.nodes),)


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop(Operation):
    """End a run: send `signal`, SIGTERM towards the end of `grace` (seconds), then SIGKILL."""

    verb, symbol = "stop", "#"
    states = frozenset({"running", "restarting", "inactive", "paused"})
    idles = ends = True

    signal: str
    grace: float
    incarnation: str
    """The run to end, remembered so that its exit does not count as a crash."""
    resumes: bool = False
    """Its container is paused, and has to be resumed to receive the signal."""

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
    """Digests of the files it reads again."""
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
    """Remove a container that does not run."""

    verb, symbol = "remove", "-"
    states = frozenset({"created", "exited", "dead"})
    ends = optional = True

    volumes: bool = False
    """Remove its anonymous volumes too, because nothing will use them again."""
    last_words: bool = False
    """It failed: keep the last lines of its log in the journal."""

    def details(self) -> tuple[str, ...]:
        return (
            *(["with anonymous volumes"] if self.volumes else []),
            *(["its last log lines are kept"] if self.last_words else []),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectOperation(Operation):
    """A call on a network or volume; it touches no container."""

    object: Kind
    name: str


@dataclass(frozen=True, slots=True, kw_only=True)
class CreateObject(ObjectOperation):
    """Create a network or volume."""

    verb, symbol = "create", "+"
    brings_up = True

    spec: Mapping[str, Any]
    labels: Mapping[str, str]
    digest: str

    @property
    def attempted(self) -> str:
        return self.digest


@dataclass(frozen=True, slots=True, kw_only=True)
class RemoveObject(ObjectOperation):
    """Remove a network, or a volume with all its data."""

    verb, symbol = "remove", "-"


OPERATIONS: tuple[type[Operation], ...] = (
    *(Create, Update, Rename, Signal, Start, Resume, Activate, Deactivate, Pause, Stop, Remove),
)
"""Operations on containers, in the order in which a summary counts them."""
