"""Idling, budgets, pressure and updates: the kind Policy, and the parts of it that services may set themselves."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from rorg.manifest.fields import TEXTS, Written, field, unchanging
from rorg.manifest.notify import Targets
from rorg.manifest.option_forms import Duration, Interval, Memory, Name, Strict
from rorg.manifest.probes import Interlock


def _units(value: object) -> object:
    if isinstance(value, list) and all(isinstance(v, str) for v in value):
        return dict.fromkeys(value, 1)
    if isinstance(value, str):
        raise ValueError(f"must be a list of names, or a mapping of numbers; try [{value}]")
    return value


Units = Annotated[
    dict[Name, Annotated[int, Field(ge=1)]],
    BeforeValidator(_units),
    Written("list of names | mapping of numbers", TEXTS),
]
"""Exclusive resources with their units: `[gpu]` or `{gpu: 1}`."""
Fraction = Annotated[float, Field(strict=False, gt=0, le=1)]
Percent = Annotated[float, Field(strict=False, gt=0, le=100)]


class Escalate(Strict):
    """A second, harder step for a service that stays idle."""

    after: Duration = unchanging("Time since it was paused, deactivated or stopped.", "10m", ...)
    action: Literal["pause", "stop", "remove"] = unchanging(
        "The second step; pause only for `action: deactivate`.", "remove", "stop"
    )


class Idle(Strict):
    """The action for a service that is no longer wanted."""

    action: Literal["pause", "deactivate", "stop", "remove"] | None = unchanging(
        "pause keeps its memory and resumes instantly; deactivate brings its managed nodes of ROS 2 (`ros.lifecycle`) "
        "to the state inactive; stop ends its processes; remove also removes the container.",
        "pause",
        unset="stop",
    )
    linger: Duration | None = unchanging("How long it stays active once it is no longer wanted.", "20s", unset="0s")
    min_active: Duration | None = unchanging(
        "Minimum time that it stays active after a start or resume.", "1m", unset="0s"
    )
    escalate: Escalate | None = unchanging(
        "A harder step for a service that stays idle, such as stop after 10 minutes.",
        {"after": "10m", "action": "stop"},
    )
    reclaim: bool | None = unchanging(
        "Push a paused service's memory out to swap, if the machine has swap.", True, unset="false"
    )
    connected: Literal["pause", "stop"] | None = unchanging(
        "The action instead of a pause while a topic connects one of its ROS nodes to another active service, or "
        "if that is unknown.",
        "stop",
        unset="pause",
    )

    @model_validator(mode="before")
    @classmethod
    def _without_effect(cls, value: object) -> object:
        """Drops `prewarm`, so that a tree that still says it loads for one more version; validation warns of it."""
        return {key: v for key, v in value.items() if key != "prewarm"} if isinstance(value, dict) else value


class Budget(Strict):
    """The most that all programs of the machine together should use."""

    cpu: Annotated[float, Field(strict=False, gt=0), Written("number of cores")] | None = field(
        "CPU, in cores.", 3.2, unset="all of the machine's"
    )
    memory: Memory | None = field("Memory.", "6Gi", unset="all of the machine's")
    over: Literal["admit", "queue", "refuse"] = field(
        "The action for a request whose services' expected use (`resources`) does not fit beside what is already "
        "wanted.",
        "queue",
        "admit",
    )


class Pressure(Strict):
    """When measures against overload begin and end."""

    high: Fraction = field("Fraction of the budget above which measures are taken, one after another.", 0.95, 1.0)
    low: Fraction = field("Fraction of the budget below which measures are undone, one after another.", 0.8, 0.85)
    cpu_some: Percent | None = field(
        "PSI: percent of time in which some program waited for the CPU, above which it is under pressure.",
        60,
        unset="not checked",
    )
    memory_some: Percent | None = field("The same for memory.", 10, 20.0)
    step: Interval = field("Time between two samples, and between two measures.", "1s", 0.5)
    calm: Duration = field("How long it must be below `low` before a measure is undone.", "10s", 5.0)
    admit: Annotated[int, Field(ge=0, le=100)] = field(
        "Priority below which nothing new is started while under pressure.", 70, 60
    )

    @model_validator(mode="after")
    def _order(self) -> Pressure:
        if self.low > self.high:
            raise ValueError("low must not be above high")
        return self


class Images(Strict):
    """When images are pulled or built, and how many are kept."""

    pull: Literal["missing", "never"] = field(
        "Whether a running rorg pulls missing images that no Image of the tree declares.", "never", "missing"
    )
    build: Literal["missing", "never"] = field(
        "Whether a running rorg builds an Image of the tree that has changed; never leaves it to `rorg build`.",
        "never",
        "missing",
    )
    keep: Annotated[int, Field(ge=1, le=100)] = field(
        "Revisions of the manifests whose images `rorg image prune` keeps for a rollback.", 10, 5
    )

    @model_validator(mode="before")
    @classmethod
    def _moved(cls, value: object) -> object:
        if isinstance(value, dict) and "update" in value:
            raise ValueError(
                "`update` is not part of `images`; for all changes write `updates: {when: when_ceased}` beside it"
            )
        return value


Set = Annotated[bool | Name, Written("true | false | name of a set")]


class Update(Strict):
    """How changes are rolled out."""

    when: Literal["now", "when_ceased", "confirmed"] | None = unchanging(
        "now; when it is next idle or restarted; or, for drivers, when it is idle, fails, or a person confirms it with "
        "`rorg apply`. An interlock can delay it further.",
        "when_ceased",
        unset="now; confirmed for drivers",
    )
    bake: Duration | None = unchanging(
        "How long it must stay well after it is ready, before rorg removes the previous container. If it fails, rorg "
        "restores that one.",
        "1m",
        unset="2s",
    )
    atomic: Set | None = unchanging(
        "Changes together with all other atomic services (true), or with those of a set: if one fails, all go back.",
        "navigation",
        unset="false",
    )


class History(Strict):
    """How much history is kept."""

    days: Annotated[float, Field(strict=False, ge=1, le=36_500)] = field("For how many days.", 90, 400.0)
    events: Annotated[int, Field(ge=1000, le=1_000_000)] = field(
        "How many entries of the journal; 20000 entries about people's actions are kept in addition.", 20_000, 100_000
    )
    revisions: Annotated[int, Field(ge=10, le=100_000)] = field("How many revisions of the manifests.", 200, 1000)


class PolicySpec(Strict):
    """Settings of the loop, for the whole machine."""

    idle: Idle | None = field("Default for services that declare none.", {"action": "pause", "linger": "20s"})
    resync: Interval = field("Time between two full lists of the engine.", "2m", 60.0)
    bulk_workers: Annotated[int, Field(ge=1, le=16)] | None = field(
        "Concurrent engine calls for work that no request waits for.",
        4,
        unset="2; 8 for `rorg apply` while no rorg runs, because nothing can be requested meanwhile",
    )
    budget: Budget | None = field(
        "The most that all programs of the machine together should use.",
        {"cpu": 3.2, "memory": "6Gi"},
        unset="the whole machine",
    )
    pressure: Pressure | None = field(
        "When measures against overload begin and end. Without it, load is not checked.", {"high": 1.0, "low": 0.85}
    )
    resources: Units = field("How many of each exclusive resource there are.", {"gpu": 2}, dict)
    interlock: Interlock | None = field(
        "For drivers and protected services that have none of their own.", {"file": "/run/robot/may-restart"}
    )
    images: Images | None = field(
        "When images are pulled or built, and how many are kept.", {"pull": "never", "keep": 10}
    )
    updates: Update | None = field(
        "How changes are rolled out, for services that do not set it themselves.", {"when": "when_ceased", "bake": "1m"}
    )
    history: History | None = field("How much history is kept.", {"days": 90})
    notify: Targets = field(
        "Whom to notify of what goes wrong, by a command or a webhook.",
        [{"name": "ntfy", "webhook": {"url": "https://ntfy.example.org/nora", "template": "{message}"}}],
        list,
    )
    removals: Literal["ask", "auto"] = field(
        "The action for a service that is no longer declared although a request, a need or a group names it: "
        "ask keeps it until a person confirms the removal; auto removes it.",
        "auto",
        "ask",
    )
    purge_ros: bool = field(
        "Remove the registrations of killed ROS 1 nodes of this machine from the master.", False, True
    )
    purge_shm: bool = field(
        "Remove what dead ROS 2 participants left in the machine's /dev/shm, when no ROS 2 service runs and no process "
        "uses it. It does not show who made it, so this concerns programs outside of rorg too.",
        True,
        False,
    )
