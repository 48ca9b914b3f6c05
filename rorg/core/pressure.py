"""Answers to pressure, when the machine has too little CPU or memory: one measure after another, mildest first, undone
in reverse order.

A state machine over samples of load. Its state is only which measures are in force and which services were shed;
everything else follows from the current sample. Time-sharing a small on-board computer is the purpose of rorg (paper,
section III-C).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

from rorg.model.load import Load
from rorg.model.policy import Budget, Thresholds
from rorg.model.units import format_memory

MEASURES = ("lower-shares", "end-lingering", "stop-paused", "close-admission", "shed")
"""In the order in which they are taken. `shed` can be taken many times, for one service each."""
LOWERED_SHARES = 103
"""CPU shares of a service that leaves the CPU to others: a tenth of Docker's default of 1024. The odd number is a mark:
after a crash, rorg recognizes which shares it lowered and restores them."""
FLAP = 60.0
"""If a service must be shed again within this many seconds after it came back, it waits twice as long the next time."""
CALM_MOST = 300.0
"""Seconds; upper limit of that wait."""
LEAST = {"cpu": 0.02, "memory": 8 << 20}
"""Cores, or bytes. Freeing less of what is short does not help,"""
SHARE = 0.05
"""nor does freeing less than this share of the excess."""
OTHERS = "programs outside rorg"
PATIENCE = 30.0
"""Seconds to wait for shed services to end before the next measure, and for services to come up before any is shed. If
it takes longer, something hangs and waiting would not help."""


@dataclass(frozen=True, slots=True)
class Shed:
    """A service that was ceased to make room. Its use includes services that ceased with it."""

    service: str
    cpu: float
    memory: int
    reason: str


@dataclass(frozen=True, slots=True)
class Pressure:
    """The state: the first `level` of MEASURES are in force, and these services are shed."""

    level: int = 0
    pressed: tuple[str, ...] = ()
    """Resources above their threshold: cpu, memory."""
    skipped: frozenset[str] = frozenset()
    """Milder measures that are not in force because they would not have helped."""
    helpless: bool = False
    """Whether pressure goes on and no measure would help."""
    reason: str = ""
    shed: tuple[Shed, ...] = ()
    changed_at: float = 0.0
    """When a measure was last taken or undone."""
    calm_since: float | None = None
    seen: float = float("-inf")
    """`at` of the last sample."""
    restored: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Service -> (when it came back, how long calm must last before the next time)."""

    @property
    def engaged(self) -> bool:
        return bool(self.level or self.shed)

    def in_force(self, measure: str) -> bool:
        return self.level > MEASURES.index(measure) and measure not in self.skipped


Victim = tuple[str, float, int]
"""A service that could be shed, with the cores and bytes it would free, including services that cease with it."""


@dataclass(frozen=True, slots=True)
class Chances:
    """What could be done now."""

    useful: frozenset[str] = frozenset()
    """The measures that would change something now."""
    next_shed: Callable[[tuple[str, ...]], Victim | None] = lambda _: None
    """Which service to shed next, given what is pressed."""
    settling: bool = False
    """Whether the last shed service has yet to end."""
    beginning: bool = False
    """Whether a service is starting, or too new to be in a sample, so that its use cannot be attributed."""
    below: Callable[[str], Sequence[Victim]] = lambda _: ()
    """Running services that could be shed in place of a more important one, least important first."""


NONE = Pressure()


def pressed(limits: Thresholds, budget: Budget | None, load: Load) -> dict[str, str]:
    """Return the resources above their threshold, with the figures in words."""
    cores, memory = _budget(budget, load)
    above: dict[str, str] = {}
    if load.cpu > limits.high * cores:
        above["cpu"] = f"{load.cpu:.1f} of {limits.high * cores:.1f} cores in use"
    elif limits.cpu_some is not None and load.cpu_some > limits.cpu_some:
        above["cpu"] = f"programs waited for the CPU {load.cpu_some:.0f} % of the time"
    if load.memory > limits.high * memory:
        above["memory"] = f"{format_memory(load.memory)} of {format_memory(limits.high * memory)} of memory in use"
    elif limits.memory_some is not None and load.memory_some > limits.memory_some:
        above["memory"] = f"programs waited for memory {load.memory_some:.0f} % of the time"
    return above


def excess(limits: Thresholds, budget: Budget | None, load: Load) -> dict[str, float]:
    """Return by how much it is above, in cores and bytes; 0 if use is below the threshold but programs wait."""
    cores, memory = _budget(budget, load)
    most = {"cpu": load.cpu - limits.high * cores, "memory": load.memory - limits.high * memory}
    return {what: max(0.0, most[what]) for what in pressed(limits, budget, load)}


def helps(over: Mapping[str, float], cpu: float, memory: float) -> bool:
    """Return whether freeing this much makes a difference to what is short."""
    freed = {"cpu": cpu, "memory": memory}
    return any(freed[what] >= max(LEAST[what], SHARE * much) for what, much in over.items())


def cause(load: Load, what: str, own: Mapping[str, tuple[float, float]] | None = None) -> str:
    """Return in words who uses most of what is short: among all, or among `own` services and programs outside rorg."""
    index = 0 if what == "cpu" else 1
    total = load.cpu if what == "cpu" else load.memory
    others = max(0.0, total - sum(use[index] for use in load.use.values()))
    used = {OTHERS: others, **{n: use[index] for n, use in (load.use if own is None else own).items()}}
    first = sorted((n for n in used if used[n] >= SHARE * total or n in (own or ())), key=lambda n: (-used[n], n))[:3]
    words = [f"{used[n]:.1f} by {n}" if what == "cpu" else f"{format_memory(used[n])} by {n}" for n in first]
    return f" ({', '.join(words)})" if words and load.use else ""


def calm(limits: Thresholds, budget: Budget | None, load: Load) -> bool:
    """Return whether load is well below every threshold. The gap between `high` and `low` keeps measures from
    flapping."""
    cores, memory = _budget(budget, load)
    share = limits.low / limits.high
    return (
        load.cpu <= limits.low * cores
        and load.memory <= limits.low * memory
        and (limits.cpu_some is None or load.cpu_some <= share * limits.cpu_some)
        and (limits.memory_some is None or load.memory_some <= share * limits.memory_some)
    )


def advance(
    state: Pressure, limits: Thresholds | None, budget: Budget | None, load: Load | None, chances: Chances
) -> Pressure:
    """Return the state after a sample. Without thresholds, or before the first sample, nothing is in force."""
    if limits is None or load is None:
        return NONE
    if load.at <= state.seen:
        return state
    state = replace(state, seen=load.at)
    over = pressed(limits, budget, load)
    # A sample covers the time since the one before. Only a sample that began after the last measure shows its effect.
    tells = not state.engaged or load.at - state.changed_at >= 2 * limits.step - 0.01
    tells = tells and not (chances.settling and load.at - state.changed_at < PATIENCE)
    if over:
        state = replace(
            state,
            pressed=tuple(over),
            calm_since=None,
            reason="; ".join(text + cause(load, what) for what, text in over.items()),
        )
        return _more(state, over, load, chances) if tells and load.use else state
    state = replace(state, helpless=False)
    if not state.engaged:
        return replace(state, pressed=(), reason="")
    if tells and (swapped := _swap(state, limits, budget, load, chances)):
        return swapped
    if not calm(limits, budget, load):
        return replace(state, pressed=(), calm_since=None)
    since = load.at if state.calm_since is None else state.calm_since
    return _less(replace(state, pressed=(), calm_since=since), limits, budget, load)


def _budget(budget: Budget | None, load: Load) -> tuple[float, float]:
    cores = budget.cpu if budget and budget.cpu is not None else load.cores
    return cores, float(budget.memory if budget and budget.memory is not None else load.memory_total)


def _more(state: Pressure, over: Mapping[str, str], load: Load, chances: Chances) -> Pressure:
    """Take the mildest measure that helps and is not yet in force."""
    state = replace(state, helpless=False)
    for measure in MEASURES[:-1]:
        if measure in chances.useful and not state.in_force(measure):
            return replace(_take(state, measure), changed_at=load.at)
    if chances.beginning:
        return state
    chosen = chances.next_shed(state.pressed)
    if chosen is None:
        return replace(state, helpless=True)
    own = {chosen[0]: chosen[1:]}
    why = "; ".join(text + cause(load, what, own) for what, text in over.items())
    return _shed(_take(state, "shed"), chosen, f"shed under pressure: {why}", load)


def _take(state: Pressure, measure: str) -> Pressure:
    level = max(state.level, MEASURES.index(measure) + 1)
    return replace(
        state, level=level, skipped=frozenset(m for m in MEASURES[:level] if m != measure and not state.in_force(m))
    )


def _shed(state: Pressure, victim: Victim, reason: str, load: Load) -> Pressure:
    name, cpu, memory = victim
    at, wait = state.restored.get(name, (float("-inf"), 0.0))
    wait = min(2 * wait, CALM_MOST) if load.at - at < FLAP + wait else 0.0
    return replace(
        state,
        changed_at=load.at,
        restored={**state.restored, name: (at, wait)},
        shed=(*state.shed, Shed(name, cpu, memory, reason)),
    )


def _swap(state: Pressure, limits: Thresholds, budget: Budget | None, load: Load, chances: Chances) -> Pressure | None:
    """Bring back a shed service that now matters more than others that run, by shedding those. Only if it fits then;
    otherwise services would be swapped back and forth."""
    core_limit, memory_limit = (limits.high * most for most in _budget(budget, load))
    for shed in state.shed:
        cpu_use, memory_use, victims = load.cpu + shed.cpu, load.memory + shed.memory, []
        for victim in chances.below(shed.service):
            over = {"cpu": cpu_use - core_limit, "memory": memory_use - memory_limit}
            if cpu_use <= core_limit and memory_use <= memory_limit:
                break
            if not helps({what: much for what, much in over.items() if much > 0}, *victim[1:]):
                continue
            victims.append(victim)
            cpu_use, memory_use = cpu_use - victim[1], memory_use - victim[2]
        if not victims or cpu_use > core_limit or memory_use > memory_limit:
            continue
        wait = state.restored.get(shed.service, (0.0, 0.0))[1]
        state = replace(
            state,
            shed=tuple(s for s in state.shed if s is not shed),
            calm_since=None,
            restored={**state.restored, shed.service: (load.at, max(wait, limits.calm))},
        )
        for victim in victims:
            state = _shed(state, victim, f"shed under pressure, in place of {shed.service}, which matters more", load)
        return state
    return None


def without(state: Pressure, services: Collection[str]) -> Pressure:
    """Return the state with these services no longer shed, without waiting for room."""
    return replace(state, shed=tuple(s for s in state.shed if s.service not in services))


def _less(state: Pressure, limits: Thresholds, budget: Budget | None, load: Load) -> Pressure:
    """Undo the last measure after calm has lasted long enough. A shed service comes back only if it fits."""
    since = load.at if state.calm_since is None else state.calm_since
    cores, memory = _budget(budget, load)
    for shed in reversed(state.shed):
        wait = max(limits.calm, state.restored.get(shed.service, (0.0, 0.0))[1])
        if load.at - since < wait:
            continue
        if load.cpu + shed.cpu <= limits.high * cores and load.memory + shed.memory <= limits.high * memory:
            left = tuple(s for s in state.shed if s is not shed)
            return replace(
                state,
                shed=left,
                changed_at=load.at,
                calm_since=load.at,
                restored={**state.restored, shed.service: (load.at, wait)},
            )
    if not state.level or load.at - since < limits.calm:
        return state
    # A shed service that does not fit stays shed, but other measures may be undone.
    level = state.level - 1
    while level and MEASURES[level - 1] in state.skipped:
        level -= 1
    undone = replace(
        state, level=level, skipped=state.skipped & {*MEASURES[:level]}, changed_at=load.at, calm_since=load.at
    )
    return undone if undone.engaged else replace(undone, reason="")
