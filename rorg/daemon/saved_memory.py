"""The part of the loop's memory that survives a restart, as JSON for each service. Times are of the day, in seconds
since the epoch, because the loop's clock starts again with every boot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from rorg.core.memory import CAP, Attempt, Memory, Progress
from rorg.daemon.snapshot import restore, run_json

TIMES = ("unwanted_since", "ceased_since")
NEVER = float("inf")


def saved_progress(step: Progress, epoch: float) -> dict[str, Any]:
    """What to keep of a service; `epoch` is the time of day at which the loop's clock was at 0. Attempts that failed
    because something is missing on this machine are left out: it may be there next time."""
    times = {name: round(at + epoch, 3) for name in TIMES if (at := getattr(step, name)) is not None}
    attempts = {
        verb: [list(map(str, t.signature)), t.count, round(t.at + epoch, 3) if t.at else 0.0, t.error]
        for verb, t in step.attempts.items()
        if not t.missing
    }
    more = {
        "crashes": step.crashes,
        "exits": step.exits,
        "exited": step.exited,
        "hung": step.hung,
        "relied_on": step.relied_on,
        "said": step.error,
        "tries": attempts,
    }
    return {**run_json(step, NEVER), **times, **{key: value for key, value in more.items() if value}}


def remembered(runs: Mapping[str, Any], now: float, epoch: float, booted_at: float) -> Memory:
    """The memory that a loop begins with. `now` is its clock, `epoch` as above, `booted_at` the time of day of the
    machine's boot. A time in the future counts as now, because the clock was set meanwhile; back-offs start again after
    a boot. Malformed entries are ignored."""
    progress = restore({"runs": runs}).progress
    return Memory({n: _with_times(step, runs[n], now, epoch, booted_at) for n, step in progress.items()})


def _with_times(step: Progress, known: Mapping[str, Any], now: float, epoch: float, booted_at: float) -> Progress:
    step = replace(
        step,
        crashes=_count(known.get("crashes")),
        exited=_text(known.get("exited")),
        hung=_text(known.get("hung")),
        relied_on=_text(known.get("relied_on")),
        unwanted_since=_past(known.get("unwanted_since"), now, epoch),
        ceased_since=_past(known.get("ceased_since"), now, epoch),
    )
    tries = _tries(known.get("tries"), now, epoch)
    if any(t.at + epoch < booted_at for t in tries.values() if t.at) or not (tries or known.get("exits")):
        return step
    return replace(step, exits=_count(known.get("exits")), error=_text(known.get("said")), attempts=tries)


def _past(at: Any, now: float, epoch: float) -> float | None:
    return min(now, float(at) - epoch) if isinstance(at, int | float) else None


def _tries(known: Any, now: float, epoch: float) -> dict[str, Attempt]:
    found = {}
    for verb, said in known.items() if isinstance(known, Mapping) else ():
        if not (isinstance(said, list) and len(said) == 4 and isinstance(said[2], int | float)):
            continue
        signature, count, at, error = said
        if isinstance(signature, list):
            due = min(now + CAP, float(at) - epoch) if at else 0.0
            found[str(verb)] = Attempt(tuple(map(_text, signature)), _count(count), due, _text(error))
    return found


def _count(value: Any) -> int:
    return value if type(value) is int and value >= 0 else 0


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ""
