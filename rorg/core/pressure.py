"""What to do while the machine is under pressure: one measure after another, mildest first, undone in reverse.

A state machine over samples of load. It keeps which measures are in force and what was shed; everything else follows
from the current sample.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from rorg.manifest.catalog import Budget, Thresholds
from rorg.manifest.scalars import format_memory

MEASURES = ("lower-shares", "end-lingering", "stop-paused", "close-admission", "shed")
"""In the order in which they are taken. `shed` can be taken many times, for one service each."""
LOWERED_SHARES = 103
"""CPU shares of a service that is to leave the CPU to others: a tenth of the engine's default of 1024, and a number
that nobody writes, so that a rorg that was killed meanwhile still knows whose shares to put back."""
FLAP = 60.0
"""Seconds within which a service that must be shed again has its time of calm doubled."""
CALM_MOST = 300.0


@dataclass(frozen=True, slots=True)
class Load:
    """One sample of the machine. `at` is the loop's clock, seconds."""

    at: float
    cpu: float
    """Cores in use since the sample before."""
    cores: float
    memory: int
    """Bytes in use: what is not available."""
    memory_total: int
    cpu_some: float = 0.0
    """PSI, percent of the last 10 s in which some program waited."""
    memory_some: float = 0.0
    use: Mapping[str, tuple[float, int]] = field(default_factory=dict)
    """Service -> (cores, bytes); empty while nobody asks for it."""


@dataclass(frozen=True, slots=True)
class Shed:
    """A service that was ceased to make room, with what it and all that went with it used."""

    service: str
    cpu: float
    memory: int
    reason: str


@dataclass(frozen=True, slots=True)
class Pressure:
    """Measures in force: the first `level` of MEASURES, and what was shed."""

    level: int = 0
    pressed: tuple[str, ...] = ()
    """What is above its threshold: cpu, memory."""
    reason: str = ""
    shed: tuple[Shed, ...] = ()
    changed_at: float = 0.0
    """When the last measure was taken or undone."""
    calm_since: float | None = None
    seen: float = float("-inf")
    """`at` of the last sample that was considered."""
    restored: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Service -> (when it was put back, how long calm must last before the next time)."""

    def in_force(self, measure: str) -> bool:
        return self.level > MEASURES.index(measure)


@dataclass(frozen=True, slots=True)
class Chances:
    """What could be done now: whether a measure would change anything, and whom to shed next."""

    useful: frozenset[str] = frozenset()
    """Those of MEASURES that would change something now."""
    next_shed: Callable[[tuple[str, ...]], tuple[str, float, int] | None] = lambda pressed: None
    """(service, cores, bytes that it and all that goes with it use), given what is pressed."""


NONE = Pressure()


def pressed(limits: Thresholds, budget: Budget | None, load: Load) -> dict[str, str]:
    """What is above its threshold, each with the figures in words."""
    cores, memory = _budget(budget, load)
    found: dict[str, str] = {}
    if load.cpu > limits.high * cores:
        found["cpu"] = f"{load.cpu:.1f} of {limits.high * cores:.1f} cores in use"
    elif limits.cpu_some is not None and load.cpu_some > limits.cpu_some:
        found["cpu"] = f"programs waited for the CPU {load.cpu_some:.0f} % of the time"
    if load.memory > limits.high * memory:
        found["memory"] = f"{format_memory(load.memory)} of {format_memory(limits.high * memory)} of memory in use"
    elif limits.memory_some is not None and load.memory_some > limits.memory_some:
        found["memory"] = f"programs waited for memory {load.memory_some:.0f} % of the time"
    return found


def calm(limits: Thresholds, budget: Budget | None, load: Load) -> bool:
    """Well below every threshold."""
    cores, memory = _budget(budget, load)
    share = limits.low / limits.high
    return (load.cpu <= limits.low * cores and load.memory <= limits.low * memory
            and (limits.cpu_some is None or load.cpu_some <= share * limits.cpu_some)
            and (limits.memory_some is None or load.memory_some <= share * limits.memory_some))


def advance(state: Pressure, limits: Thresholds | None, budget: Budget | None, load: Load | None, chances: Chances
            ) -> Pressure:
    """The state after a sample. Without thresholds, or before the first sample, nothing is in force."""
    if limits is None or load is None:
        return NONE
    if load.at <= state.seen:
        return state
    state = replace(state, seen=load.at)
    over = pressed(limits, budget, load)
    if over:
        state = replace(state, pressed=tuple(over), reason="; ".join(over.values()), calm_since=None)
        # A sample covers the time since the one before: only one that began after the last measure tells its effect.
        return state if state.level and load.at - state.changed_at < 2 * limits.step - 0.01 else _more(
            state, load, chances)
    if not state.level:
        return replace(state, pressed=(), reason="")
    if not calm(limits, budget, load):
        return replace(state, pressed=(), calm_since=None)
    since = load.at if state.calm_since is None else state.calm_since
    return _less(replace(state, pressed=(), calm_since=since), limits, budget, load)


def _budget(budget: Budget | None, load: Load) -> tuple[float, float]:
    cores = budget.cpu if budget and budget.cpu is not None else load.cores
    return cores, float(budget.memory if budget and budget.memory is not None else load.memory_total)


def _more(state: Pressure, load: Load, chances: Chances) -> Pressure:
    """Takes the next measure that changes anything."""
    level = state.level
    while level < len(MEASURES) - 1:
        level += 1
        if MEASURES[level - 1] in chances.useful:
            return replace(state, level=level, changed_at=load.at)
    chosen = chances.next_shed(state.pressed)
    if chosen is None:
        return replace(state, level=max(level, state.level))
    name, cpu, memory = chosen
    restored = dict(state.restored)
    at, wait = restored.get(name, (float("-inf"), 0.0))
    restored[name] = (at, min(2 * wait, CALM_MOST) if load.at - at < FLAP + wait else 0.0)
    return replace(state, level=len(MEASURES), changed_at=load.at, restored=restored,
                   shed=(*state.shed, Shed(name, cpu, memory, f"shed under pressure: {state.reason}")))


def _less(state: Pressure, limits: Thresholds, budget: Budget | None, load: Load) -> Pressure:
    """Undoes the last measure, once calm has lasted; what was shed comes back only when it fits."""
    since = load.at if state.calm_since is None else state.calm_since
    cores, memory = _budget(budget, load)
    for shed in reversed(state.shed):
        wait = max(limits.calm, state.restored.get(shed.service, (0.0, 0.0))[1])
        if load.at - since < wait:
            continue
        if load.cpu + shed.cpu <= limits.high * cores and load.memory + shed.memory <= limits.high * memory:
            left = tuple(s for s in state.shed if s is not shed)
            return replace(state, shed=left, changed_at=load.at, calm_since=load.at,
                           restored={**state.restored, shed.service: (load.at, wait)})
    if state.shed or load.at - since < limits.calm:
        return state
    level = state.level - 1
    return replace(state, level=level, changed_at=load.at, calm_since=load.at, reason=state.reason if level else "")
