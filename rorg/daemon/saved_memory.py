"""The part of the loop's memory that survives a restart, as JSON for each service. Times are of the day, in seconds
since the epoch, because the loop's clock starts again with every boot."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from rorg.core.memory import CAP, MOST_STOPPED, Attempt, CountedOn, Memory, Progress
from rorg.core.update import Update
from rorg.daemon.snapshot import run_json

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
        "begun_with": [*step.begun_with] if all(step.begun_with) else [],
    }
    return {**run_json(step, NEVER), **times, **{key: value for key, value in more.items() if value}}


def remembered(runs: Mapping[str, Any], now: float, epoch: float, booted_at: float) -> Memory:
    """The memory that a loop begins with. `now` is its clock, `epoch` as above, `booted_at` the time of day of the
    machine's boot. A time in the future counts as now, because the clock was set meanwhile; back-offs start again after
    a boot. Malformed entries are ignored."""
    return Memory({name: _progress(known, now, epoch, booted_at) for name, known in runs.items() if _sound(known)})


def _sound(known: Any) -> bool:
    return isinstance(known, Mapping) and isinstance(known.get("needs"), Mapping)


def _progress(known: Mapping[str, Any], now: float, epoch: float, booted_at: float) -> Progress:
    said = defaultdict(str, {key: value for key, value in known.items() if isinstance(value, str)})
    update = Update(
        edition=said["edition"],
        quarantined=_texts(known.get("quarantined")),
        rejected=said["rejected"],
        broken=said["broken"],
        drawn=said["drawn"],
        proven=said["proven"],
        baked=said["baked"],
        run=said["loaded"] if isinstance(known.get("content"), Mapping) else "",
        content=_texts(known.get("content")),
    )
    step = Progress(
        counted_on=CountedOn(said["run"], _texts(known["needs"])),
        update=update,
        stopped=_stopped(known),
        crashes=_count(known.get("crashes")),
        exited=said["exited"],
        hung=said["hung"],
        relied_on=said["relied_on"],
        begun_with=_pair(known.get("begun_with")),
        unwanted_since=_past(known.get("unwanted_since"), now, epoch),
        ceased_since=_past(known.get("ceased_since"), now, epoch),
    )
    tries = _tries(known.get("tries"), now, epoch)
    if any(t.at + epoch < booted_at for t in tries.values() if t.at) or not (tries or known.get("exits")):
        return step
    return replace(step, exits=_count(known.get("exits")), error=said["said"], attempts=tries)


def _stopped(known: Mapping[str, Any]) -> tuple[str, ...]:
    """An older rorg remembered only the last one."""
    before = known.get("stopped_before")
    runs = [*(before if isinstance(before, list) else ()), known.get("stopped")]
    return tuple(run for run in runs if isinstance(run, str) and run)[-MOST_STOPPED:]


def _texts(known: Any) -> dict[str, str]:
    return {str(k): str(v) for k, v in known.items()} if isinstance(known, Mapping) else {}


def _pair(known: Any) -> tuple[str, str]:
    return (_text(known[0]), _text(known[1])) if isinstance(known, list) and len(known) == 2 else ("", "")


def _past(at: Any, now: float, epoch: float) -> float | None:
    return min(now, float(at) - epoch) if isinstance(at, int | float) else None


def _tries(known: Any, now: float, epoch: float) -> dict[str, Attempt]:
    attempts = {}
    for verb, said in known.items() if isinstance(known, Mapping) else ():
        if not (isinstance(said, list) and len(said) == 4 and isinstance(said[2], int | float)):
            continue
        signature, count, at, error = said
        if isinstance(signature, list):
            due = min(now + CAP, float(at) - epoch) if at else 0.0
            attempts[str(verb)] = Attempt(tuple(map(_text, signature)), _count(count), due, _text(error))
    return attempts


def _count(value: Any) -> int:
    return value if type(value) is int and value >= 0 else 0


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ""
