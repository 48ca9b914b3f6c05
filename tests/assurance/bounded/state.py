"""The canonical digest of everything that decides how a robot goes on: the sim engine, the faults that are under way,
the files, and rorg's memory.

Two robots with the same digest behave alike from then on. Times are relative to now. Those longer ago than OLD, which
no timer of the alphabet reaches, keep only their order. Ids of containers keep only theirs.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache

from bounded.virtual import WorldRobot

from rorg.model.units import parse_time

OLD = 100.0
"""Seconds; longer than the longest back-off and every other timer."""
TIMES = frozenset(
    (
        *("unwanted_since", "ceased_since", "running_since", "well_since", "unproven_since", "doubted_since"),
        *("answered", "denied", "at", "since", "until", "changed_at"),
    )
)
"""Fields with a time of the loop's clock."""
LEFT_OUT = frozenset(("admitted", "pressure", "crashes", "stopped", "start_number"))
"""Fields that follow from others, that no world of the alphabet changes, or that are only told. `stopped` is added
apart, without containers that are gone, and of `start_number` the order."""
MARK = re.compile(
    r"(000000[0-9a-f]{6})(?:0{52})?(?:@(\d{4}-\d\d-\d\dT[\d:.]+Z)?)?|(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(?:\.\d+)?Z)"
)
"""The id of a container, with the time at which a run of it started if it is an incarnation; or a time alone."""


@cache
def _fields(kind: type) -> tuple[str, ...]:
    return tuple(f.name for f in fields(kind) if f.init and f.name not in LEFT_OUT)


def plain(value: object, now: float) -> object:
    """Return a value as nested tuples whose text is the same for equal values."""
    if isinstance(value, (str, int, type(None))):
        return value
    if isinstance(value, float):
        return round(value, 4)
    if isinstance(value, Mapping):
        return tuple(sorted((repr(plain(k, now)), plain(v, now)) for k, v in value.items()))
    if isinstance(value, (set, frozenset)):
        return tuple(sorted(repr(plain(one, now)) for one in value))
    if isinstance(value, (tuple, list)):
        return tuple(plain(one, now) for one in value)
    assert is_dataclass(value), value
    found = []
    for name in _fields(type(value)):
        one = getattr(value, name)
        timed = name in TIMES and isinstance(one, float)
        found.append((name, age(one, now) if timed else plain(one, now)))
    return (type(value).__name__, *found)


def age(at: float, now: float) -> object:
    return "old" if now - at > OLD else round(at - now, 4)


def text_of(robot: WorldRobot, manifests: object) -> str:
    """The state as text. `manifests` says what they are now."""
    now, memory, engine = robot.now, robot.memory, robot.engine
    events = sorted(
        (
            round(t - now, 4),
            do.func.__name__,
            [robot.life - a if type(a) is int else plain(a, now) for a in do.args],
        )
        for t, _, do in robot._events
        if do.func.__name__ != "_nothing"
    )
    there = {c[:12] for c in engine.containers}
    stopped = {n: [run for run in p.stopped if run.partition("@")[0] in there] for n, p in memory.progress.items()}
    probes = {key: robot._told.get(key) for key in robot._asked}
    parts = (
        manifests,
        round(now % 1.0, 4),
        plain(engine.containers, now),
        [c.id for c in sorted(engine.containers.values(), key=lambda c: c.start_number) if c.start_number],
        plain([memory.progress, memory.in_flight, memory.leases, memory.restarts, memory.asked], now),
        [sorted(memory.kept.former), plain(stopped, now)],
        plain(robot.document, now),
        plain([robot.hung, robot.spoilt, robot.view], now),
        sorted((robot.life - life, name, mode) for (life, name), mode in robot.modes.items() if mode),
        sorted((id, age(at, now)) for id, at in robot.looked.items() if id in engine.containers),
        plain(probes, now),
        sorted((name, age(at, now)) for name, at in robot.unseen.items()),
        (robot.faults.unreachable, max(0.0, round(robot.doubled - now, 4)), memory.asked is None),
        events,
    )
    return _marked(repr(parts), robot)


def _marked(text: str, robot: WorldRobot) -> str:
    """Replace ids and times of day. Containers that are gone, and their runs, keep only who equals whom."""
    ids = {c[:12]: f"c{rank}" for rank, c in enumerate(sorted(robot.engine.containers))}
    found = {m[2] or m[3] for m in MARK.finditer(text) if m[3] or (m[2] and m[1] in ids)}
    times = {}
    for rank, at in enumerate(sorted(found)):
        ago = robot.wall - parse_time(at)
        times[at] = f"t{rank}" if ago > OLD else f"{ago:.3f}"
    gone = dict[str, str]()

    def named(match: re.Match[str]) -> str:
        if match[3]:
            return times[match[3]]
        if match[1] in ids:
            return f"{ids[match[1]]}@{times[match[2]]}" if match[2] else ids[match[1]]
        return gone.setdefault(match[0], f"gone{len(gone)}")

    return MARK.sub(named, text)


def digest_of(robot: WorldRobot, manifests: object) -> bytes:
    return hashlib.blake2b(text_of(robot, manifests).encode(), digest_size=12).digest()
