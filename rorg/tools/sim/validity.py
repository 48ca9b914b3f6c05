"""Decides whether the measurements of a run are valid, from what else used the machine and what the run got."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rorg.model.units import counted
from rorg.tools.sim.results import Response

LEAST_CPU = 0.95
"""Fraction of its CPU that each stand-in must get."""
SLACK = 0.05
"""CPU seconds that may be missing in any case: a stand-in works in bursts, and engines count in hundredths."""
MOST_OTHER = 0.1
"""Fraction of the machine's CPU that other programs may use."""
NAMED = 3
"""Services or states that a message names."""


@dataclass(frozen=True, slots=True)
class Cpu:
    """CPU seconds of a stand-in while it ran."""

    wanted: float = 0.0
    got: float = 0.0

    def __add__(self, other: Cpu) -> Cpu:
        return Cpu(self.wanted + other.wanted, self.got + other.got)

    @property
    def starved(self) -> bool:
        return self.got < LEAST_CPU * self.wanted - SLACK


@dataclass(frozen=True, slots=True)
class Conditions:
    """The machine during a run."""

    cores: float
    """Cores of the machine."""
    other: float
    """Mean number of cores that other programs used."""
    stand_ins: Mapping[str, Cpu]
    """By service."""


@dataclass(frozen=True, slots=True)
class OtherLoad:
    """Other programs used too much of the machine."""

    code = "other-load"
    remedy = "to end them, or measure on a machine that does nothing else"
    used: float
    cores: float

    @property
    def why(self) -> str:
        return f"other programs used {self.used:.2f} of {self.cores:g} cores, more than {MOST_OTHER:.0%}"


@dataclass(frozen=True, slots=True)
class Starved:
    """Stand-ins got too little CPU."""

    code = "starved"
    remedy = "a smaller --scale"
    services: Mapping[str, Cpu]

    @property
    def why(self) -> str:
        worst = sorted(self.services.items(), key=lambda item: item[1].got / item[1].wanted)
        named = ", ".join(f"{name} {cpu.got / cpu.wanted:.0%}" for name, cpu in worst[:NAMED])
        return f"{counted(len(worst), 'stand-in')} got less than {LEAST_CPU:.0%} of the CPU that they need ({named})"


@dataclass(frozen=True, slots=True)
class NeverReady:
    """Requests were released, or the trace ended, before they were ready."""

    code = "never-ready"
    remedy = "a smaller --compress"
    responses: tuple[Response, ...]
    requests: int

    @property
    def why(self) -> str:
        by_state = Counter(one.state or one.id for one in self.responses)
        named = ", ".join(f"{number} of {name}" for name, number in by_state.most_common(NAMED))
        return f"{len(self.responses)} of {self.requests} requests never became ready ({named})"


Flaw = OtherLoad | Starved | NeverReady


def flaws(conditions: Conditions, responses: Sequence[Response]) -> tuple[Flaw, ...]:
    """Why a run is not valid, the cause before its effects; empty for a valid run."""
    found = list[Flaw]()
    if conditions.other > MOST_OTHER * conditions.cores:
        found.append(OtherLoad(conditions.other, conditions.cores))
    if starved := {name: cpu for name, cpu in conditions.stand_ins.items() if cpu.starved}:
        found.append(Starved(starved))
    if never := tuple(one for one in responses if one.seconds is None):
        found.append(NeverReady(never, len(responses)))
    return tuple(found)
