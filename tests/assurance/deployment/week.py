"""The plan of a week of the tour guide: what visitors ask for, what developers push, and what breaks, each at its time.
A pure function of the seed and of the robot's services."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from random import Random

from deployment.tour_guide import Guide

from rorg.tools.sim.generate import BEHAVIOUR, Span, generate_day

DAYS = 7
WEEK = 2400.0
"""Seconds in which the week is played."""
DAY, NIGHT = WEEK / DAYS, 22.0
"""Seconds in which a day is played; so many of them at its end are the night, in which nothing is asked for."""
HOUR, GREETINGS, TOURS = 3600.0, 30, 3
"""A day is an hour such as that of the paper's deployment, compressed."""
COMPRESSED = HOUR / (DAY - NIGHT)
SOFTWARE, CONFIGURATION = 126, 71
"""Updates, as many as the paper reports."""
BAD_PART = 0.1
"""Of both kinds of updates."""
REPAIRED = Span(20, 40)
"""Seconds after which a bad update is reverted."""
APART = 40.0
"""Seconds at least between two updates of a service."""
AWAY, NO_REMOTE = Span(2, 8), Span(10, 30)
"""Seconds for which the engine, or the repository, is out of reach."""
RESTARTED = 1.0
"""Seconds after which rorg is started again, as its unit says."""
KILLS, RORG_KILLS, ENGINE_CUTS, REMOTE_CUTS = 5, 2, 2, 1
"""A day."""
WITHOUT_LIVE_RESTORE = 3
"""The day on which the engine comes back without live-restore, counted from 0."""


class Kind(StrEnum):
    """Of events."""

    ASKED = "state of the behaviour"
    NIGHT = "night"
    SOFTWARE = "software update"
    CONFIGURATION = "configuration update"
    REVERT = "revert of a bad update"
    KILL = "kill of a container"
    RORG_KILLED = "kill of rorg"
    RORG_STARTED = "start of rorg"
    ENGINE_KILLED = "kill of the engine"
    ENGINE_STOPPED = "restart of the engine"
    ENGINE_BARE = "restart of the engine without live-restore"
    ENGINE_CUT = "connection to the engine refused"
    ENGINE_SILENT = "connection to the engine silent"
    ENGINE_BACK = "connection to the engine back"
    REMOTE_CUT = "repository out of reach"
    REMOTE_BACK = "repository back"


class Bad(StrEnum):
    """What is wrong with an update."""

    NO = ""
    EXITS = "exits"
    NEVER_READY = "never ready"
    INVALID = "invalid manifest"
    COMMAND = "wrong command"


@dataclass(frozen=True)
class Event:
    at: float
    """Seconds since the week began."""
    kind: Kind
    service: str = ""
    bad: Bad = Bad.NO
    state: str = ""
    services: tuple[str, ...] = ()
    """What the behaviour asks for in this state."""


def week(seed: int, guide: Guide) -> tuple[Event, ...]:
    """All events in the order of their times."""
    visits = [*_visits(seed)]
    events = [*visits, *_updates(Random(f"updates {seed}"), guide), *_faults(Random(f"faults {seed}"), guide, visits)]
    return tuple(sorted(events, key=lambda event: event.at))


def first(events: Sequence[Event], seconds: float) -> tuple[Event, ...]:
    """The first part of a week."""
    return tuple(event for event in events if event.at < seconds)


def _visits(seed: int) -> Iterator[Event]:
    for day in range(DAYS):
        trace = generate_day(HOUR, GREETINGS, TOURS, DAYS * (seed - 1) + day + 1).compressed(COMPRESSED)
        for event in trace.events:
            if event.state:
                yield Event(day * DAY + event.at, Kind.ASKED, state=event.state, services=event.services)
        yield Event(day * DAY + trace.duration, Kind.NIGHT)


def _updates(chance: Random, guide: Guide) -> Iterator[Event]:
    """A service that was updated is left alone for a while, so that one update is judged before the next."""
    kinds = [(Kind.SOFTWARE, bad) for bad in _with_bad(SOFTWARE, (Bad.EXITS, Bad.NEVER_READY))]
    kinds += [(Kind.CONFIGURATION, bad) for bad in _with_bad(CONFIGURATION, (Bad.INVALID, Bad.COMMAND))]
    chance.shuffle(kinds)
    moments = sorted(_moment(chance, chance.randrange(DAYS), REPAIRED.most) for _ in kinds)
    busy: dict[str, float] = {}
    for at, (kind, bad) in zip(moments, kinds, strict=True):
        service = chance.choice([name for name in guide.services if busy.get(name, 0.0) <= at])
        update = Event(at, kind, service, bad)
        yield update
        repaired = at + chance.uniform(REPAIRED.least, REPAIRED.most) if bad else at
        if bad:
            yield replace(update, at=repaired, kind=Kind.REVERT)
        busy[service] = repaired + APART


def _with_bad(count: int, ways: Sequence[Bad]) -> list[Bad]:
    bad = round(count * BAD_PART)
    return [ways[number % len(ways)] for number in range(bad)] + [Bad.NO] * (count - bad)


def _moment(chance: Random, day: int, before_night: float, part: int = 0, parts: int = 1) -> float:
    """A time in a part of a day; parts leave some time between them."""
    length = (DAY - NIGHT - before_night) / parts
    return day * DAY + (part + 0.8 * chance.random() + 0.1) * length


def _faults(chance: Random, guide: Guide, visits: Sequence[Event]) -> Iterator[Event]:
    for day in range(DAYS):
        for part in range(KILLS):
            at = _moment(chance, day, 0.0, part, KILLS)
            asked = max((v for v in visits if v.at <= at), key=lambda visit: visit.at).services
            yield Event(at, Kind.KILL, chance.choice(sorted(guide.wanted((BEHAVIOUR, *asked)))))
        for part in range(RORG_KILLS):
            at = _moment(chance, day, 0.0, part, RORG_KILLS)
            yield from (Event(at, Kind.RORG_KILLED), Event(at + RESTARTED, Kind.RORG_STARTED))
        bare, kill = day == WITHOUT_LIVE_RESTORE, day % 2 == 0
        kind = Kind.ENGINE_BARE if bare else Kind.ENGINE_KILLED if kill else Kind.ENGINE_STOPPED
        yield Event(_moment(chance, day, 0.0), kind)
        for part in range(ENGINE_CUTS):
            kind = (Kind.ENGINE_CUT, Kind.ENGINE_SILENT)[part % 2]
            yield from _lasting(chance, _moment(chance, day, 0.0, part, ENGINE_CUTS), kind, Kind.ENGINE_BACK, AWAY)
        for part in range(REMOTE_CUTS):
            at = _moment(chance, day, NO_REMOTE.most, part, REMOTE_CUTS)
            yield from _lasting(chance, at, Kind.REMOTE_CUT, Kind.REMOTE_BACK, NO_REMOTE)


def _lasting(chance: Random, at: float, begin: Kind, end: Kind, lasts: Span) -> Iterator[Event]:
    yield from (Event(at, begin), Event(at + chance.uniform(lasts.least, lasts.most), end))
