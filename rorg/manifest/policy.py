"""Idling, budgets and pressure: the Policy of the machine, and what services may say of it themselves."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from rorg.manifest.container import unchanging
from rorg.manifest.option_forms import Strict
from rorg.manifest.probes import Interlock
from rorg.manifest.scalars import Duration, Interval, Memory, Name


def _units(value: object) -> object:
    return dict.fromkeys(value, 1) if isinstance(value, list) and all(isinstance(v, str) for v in value) else value


Units = Annotated[dict[Name, Annotated[int, Field(ge=1)]], BeforeValidator(_units)]
"""Exclusive resources by name, with how many units: `[gpu]` or `{gpu: 1}`."""
Fraction = Annotated[float, Field(strict=False, gt=0, le=1)]
Percent = Annotated[float, Field(strict=False, gt=0, le=100)]


class Escalate(Strict):
    """A second, harder step for a service that stays unwanted."""

    after: Duration = unchanging(..., description="How long after it was paused (or stopped).")
    action: Literal["stop", "remove"] = unchanging("stop")


class Idle(Strict):
    """What becomes of a service that nobody wants any more."""

    action: Literal["pause", "stop", "remove"] | None = unchanging(description="Default: stop.")
    linger: Duration | None = unchanging(description="How long it stays active after that. Default: 0.")
    min_active: Duration | None = unchanging(
        description="Once started or resumed, it stays active at least so long. Default: 0."
    )
    escalate: Escalate | None = unchanging(description="For instance: pause, and stop after 10 minutes.")
    reclaim: bool | None = unchanging(
        description="Push a paused service's memory out to swap, where the machine has some. Default: false."
    )


class Budget(Strict):
    """What all programs of the machine together should use at the most."""

    cpu: Annotated[float, Field(strict=False, gt=0)] | None = Field(
        default=None, description="Cores. Default: all of the machine's."
    )
    memory: Memory | None = Field(default=None, description="Default: all of the machine's.")
    over: Literal["admit", "queue", "refuse"] = Field(
        default="admit",
        description="What becomes of a request whose services' expected use (`resources`) does not "
        "fit beside what is wanted already. Default: admit.",
    )


class Pressure(Strict):
    """When measures against overload begin and end."""

    high: Fraction = Field(default=1.0, description="Of the budget: above it, one measure after another is taken.")
    low: Fraction = Field(default=0.85, description="Of the budget: below it, they are undone one after another.")
    cpu_some: Percent | None = Field(
        default=None,
        description="PSI: percent of time in which some program waited for "
        "the CPU, above which it is under pressure. Default: not looked at.",
    )
    memory_some: Percent | None = Field(default=20.0, description="The same for memory. Default: 20.")
    step: Interval = Field(default=0.5, description="Time between two samples, and between two measures.")
    calm: Duration = Field(default=5.0, description="How long it must be below `low` before a measure is undone.")
    admit: Annotated[int, Field(ge=0, le=100)] = Field(
        default=60, description="Priority below which nothing new is started while under pressure."
    )

    @model_validator(mode="after")
    def _order(self) -> Pressure:
        if self.low > self.high:
            raise ValueError("low must not be above high")
        return self


class PolicySpec(Strict):
    """Settings of the loop, for the whole machine."""

    idle: Idle | None = Field(default=None, description="For services that do not say.")
    resync: Interval = Field(default=60.0, description="Time between two full lists of the engine. Default: 60s.")
    bulk_workers: Annotated[int, Field(ge=1, le=16)] | None = Field(
        default=None,
        description="Engine calls at once for work that no request waits for. Default: 2; 8 for an `rorg apply` while "
        "no rorg runs, since nobody can request anything meanwhile.",
    )
    budget: Budget | None = None
    pressure: Pressure | None = Field(default=None, description="Without it, load is not looked at.")
    resources: Units = Field(default_factory=dict, description="How many of each exclusive resource there are.")
    interlock: Interlock | None = Field(
        default=None, description="For drivers and protected services that have none of their own."
    )
    removals: Literal["ask", "auto"] = Field(
        default="ask",
        description="What becomes of a service that is not declared any more though a request, a need "
        "or a group names it: it stays until a person has confirmed its removal, or it is "
        "removed. Default: ask.",
    )
    purge_ros: bool = Field(
        default=True,
        description="Take the registrations of killed ROS 1 nodes of this machine out of the master. Default: true.",
    )
