"""Judges what ran, by the engine's own events alone: what ran at the same time although it must not, and what rorg
called ready although it did not run. Pure: it reads values and asks nobody."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf

ACTED = 10.0
"""Seconds in which rorg must have ended what was started by hand: it stops a program with a grace period of 2 s, on a
machine that does much else."""
SAME_MOMENT = 1.0
"""Seconds in which a start by hand may not be known yet to rorg, which starts something else."""
KNOWN = 1.0
"""Seconds after the end of a run in which an answer may not know of it: the engine tells of it later, to rorg and to
us."""
BEGINS = ("start", "unpause", "restart")
"""What a hand does that begins a run."""
KILLED_PAUSED = 0.1
"""Seconds for which a paused program may be resumed after SIGKILL: it only ends. docs/how-to/idle.md."""


@dataclass(frozen=True, order=True)
class Event:
    """Of a container, as the engine wrote it. `at`: seconds since the epoch."""

    at: float
    action: str
    """start, die, pause, unpause, kill or destroy."""
    container: str
    service: str
    edition: int = 0
    """The number that its manifest had."""
    signal: str = ""
    """Of a kill."""


@dataclass(frozen=True)
class Hand:
    """What somebody does to a container behind rorg's back."""

    begin: float
    end: float
    verb: str
    container: str
    """Empty for all of them: an engine that ends resumes what is paused, to stop it."""
    service: str


@dataclass(frozen=True)
class Run:
    """A time in which the program of a container ran without a pause. `end` is infinite while it runs."""

    service: str
    container: str
    begin: float
    end: float
    started: float
    """When the program began, which may be before a pause."""
    edition: int = 0
    hand: Hand | None = None
    """What started or resumed it behind rorg's back."""

    def at(self, time: float) -> bool:
        return self.begin <= time < self.end


@dataclass(frozen=True)
class Rules:
    """Which services must not run together."""

    conflicts: frozenset[frozenset[str]] = frozenset()
    exclusive: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    """Service -> resource -> the units that it uses."""
    units: Mapping[str, int] = field(default_factory=dict)
    """Resource -> how many there are; otherwise one."""

    def broken(self, services: Sequence[str]) -> str:
        """Which rule services break that run together; "" if none. A service is named as often as it runs."""
        for number, one in enumerate(services):
            for other in services[number + 1 :]:
                if one == other:
                    return f"{one} runs twice"
                if frozenset((one, other)) in self.conflicts:
                    return f"{one} conflicts with {other}"
        used: dict[str, int] = defaultdict(int)
        for service in services:
            for resource, number in self.exclusive.get(service, {}).items():
                used[resource] += number
        over = [r for r, number in used.items() if number > self.units.get(r, 1)]
        return f"{', '.join(s for s in services if over[0] in self.exclusive.get(s, {}))} use {over[0]}" if over else ""


@dataclass(frozen=True)
class Span:
    """A time, such as one in which rorg or the engine could not act."""

    begin: float
    end: float = inf


@dataclass(frozen=True)
class Fault:
    """`kind`: overlap, ready, lost or history."""

    kind: str
    at: float
    what: str
    services: tuple[str, ...] = ()


# -- runs ------------------------------------------------------------------------------------------------------


def runs_of(events: Iterable[Event], hands: Iterable[Hand] = ()) -> list[Run]:
    """By the time at which each begins. An event that repeats what is known counts for nothing."""
    begun: dict[str, tuple[Event, float]] = {}
    started: dict[str, float] = {}
    killed: dict[str, float] = {}
    done, found = [*hands], list[Run]()

    def end(container: str, at: float) -> None:
        if container in begun:
            event, first = begun.pop(container)
            if not _only_ends(event, at, killed.get(container)):
                found.append(_run(event, first, at, done))

    for event in sorted(events):
        match event.action:
            case "start" | "unpause" if event.container not in begun:
                if event.action == "start":
                    started[event.container] = event.at
                begun[event.container] = event, started.get(event.container, event.at)
            case "kill" if event.signal in ("9", "SIGKILL") and event.container not in begun:
                killed[event.container] = event.at
            case "pause" | "die" | "destroy":
                end(event.container, event.at)
    for container in [*begun]:
        end(container, inf)
    return sorted(found, key=lambda run: run.begin)


def _run(event: Event, started: float, end: float, hands: Sequence[Hand]) -> Run:
    made = (h for h in hands if h.container in ("", event.container) and h.verb in BEGINS)
    hand = next((h for h in made if h.begin <= event.at <= h.end), None)
    return Run(event.service, event.container, event.at, end, started, event.edition, hand)


def _only_ends(event: Event, end: float, killed: float | None) -> bool:
    """Whether a paused program was resumed only to end, by a signal that lets it do nothing else."""
    near = killed is not None and abs(event.at - killed) < KILLED_PAUSED
    return event.action == "unpause" and near and end - event.at < KILLED_PAUSED


# -- overlaps --------------------------------------------------------------------------------------------------


def overlaps(runs: Sequence[Run], rules: Rules, away: Sequence[Span] = (), now: float = inf) -> list[Fault]:
    """Times in which services ran together that must not. `away`: when rorg could not act. `now`: how far is known."""
    found, running = list[Fault](), list[Run]()
    for run in runs:
        running = [r for r in running if r.end > run.begin]
        beside = [r for r in running if rules.broken((r.service, run.service))]
        used = rules.exclusive.get(run.service, {})
        users = [r for r in running if used.keys() & rules.exclusive.get(r.service, {}).keys()]
        # More users than units, of which no two are too many.
        for group in [[r] for r in beside] or ([users] if rules.broken([*_names(users), run.service]) else []):
            if not _excused([*group, run], away, now):
                end = min(r.end for r in [*group, run])
                names = _names([*group, run])
                how = f"{rules.broken(names)} for {min(end, now) - run.begin:.3f} s"
                found.append(Fault("overlap", run.begin, how, names))
        running.append(run)
    return found


def _names(runs: Iterable[Run]) -> tuple[str, ...]:
    return tuple(run.service for run in runs)


def _excused(group: Sequence[Run], away: Sequence[Span], now: float) -> bool:
    """Whether a run by hand made this overlap, and it ended as soon as rorg could act. `group` ends with the run that
    makes the overlap."""
    last, ended = group[-1], min([now, *(run.end for run in group)])
    by_hand = [(run, run.hand) for run in group if run.hand]
    if not by_hand:
        return False
    # A start that was under way already takes as long as that by hand did.
    late = [acting(run.begin, last.begin, away) > SAME_MOMENT + hand.end - hand.begin for run, hand in by_hand]
    if not last.hand and all(late):
        return False  # rorg started it beside what it must have seen
    return acting(last.begin, ended, away) <= ACTED


def acting(begin: float, end: float, away: Sequence[Span]) -> float:
    """Seconds between two times in which rorg could act. Spans may overlap."""
    left, at = 0.0, begin
    for span in sorted(away, key=lambda one: one.begin):
        if span.end <= at or span.begin >= end:
            continue
        left += max(0.0, span.begin - at)
        at = max(at, span.end)
    return left + max(0.0, end - at)


# -- ready -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Answer:
    """That rorg called services ready."""

    asked: float
    at: float
    services: tuple[str, ...]
    """With all that they need."""
    editions: Mapping[str, frozenset[int]] = field(default_factory=dict)
    """Service -> the editions that may run, if that is known."""
    files: Mapping[str, float] = field(default_factory=dict)
    """Service -> when the file that it mounts was written: a run must have begun after that."""
    how: str = ""


def false_ready(answer: Answer, runs: Sequence[Run]) -> list[Fault]:
    """Services that did not run when an answer called them ready, or ran in another version."""
    found = []
    for service in answer.services:
        # A run may have ended so late that nobody could know of it.
        then = [r for r in runs if r.service == service and r.begin <= answer.at and r.end > answer.at - KNOWN]
        why = "" if then else "did not run"
        right = answer.editions.get(service)
        if then and right is not None and not any(run.edition in right for run in then):
            why = f"ran in edition {[run.edition for run in then]} in place of {sorted(right)}"
        elif then and all(run.started < answer.files.get(service, 0.0) for run in then):
            late = answer.files[service] - max(run.started for run in then)
            why = f"had begun {late:.3f} s before the file was written that it mounts"
        if why:
            text = f"{answer.how}: {service} {why} (asked {answer.at - answer.asked:.3f} s before the answer)"
            found.append(Fault("ready", answer.at, text, (service,)))
    return found
