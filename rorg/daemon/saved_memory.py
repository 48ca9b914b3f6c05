"""The part of the loop's memory that survives a restart, as JSON for each service. Times are of the loop's clock, which
starts again with every boot. Those of an earlier boot say nothing: nobody knows how long the machine was off, because
its clock may have been set."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

from rorg.core.memory import CAP, MOST_STOPPED, Attempt, CountedOn, Due, Memory, Progress
from rorg.core.update import LastGood, Update
from rorg.daemon.snapshot import run_json
from rorg.model.probe import Probe

TIMES = ("unwanted_since", "ceased_since")
NEVER = float("inf")


def saved_progress(step: Progress, due: Due | None, boot: str) -> dict[str, Any]:
    """What to keep of a service in this boot, with its requested restart. Attempts that failed because something is
    missing on this machine, or because the engine did not answer, are left out: it may be different next time."""
    times = {name: round(at, 3) for name in TIMES if (at := getattr(step, name)) is not None}
    attempts = {
        verb: [list(map(str, t.signature)), t.count, round(t.at, 3) if t.at else 0.0, t.error]
        for verb, t in step.attempts.items()
        if not (t.missing or t.unanswered)
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
        "interrupted": step.update.interrupted,
        "restart": [due.stamp, due.run] if due else [],
        "boot": boot,
    }
    return {**run_json(step, NEVER), **times, **{key: value for key, value in more.items() if value}}


def remembered(runs: Mapping[str, Any], now: float, boot: str) -> Memory:
    """The memory that a loop begins with. `now` is its clock, and `boot` the id of this boot. What lasted in an earlier
    boot begins now, and back-offs are over. Malformed entries are ignored."""
    sound = {name: known for name, known in runs.items() if _sound(known)}
    due = {name: Due(*pair) for name, known in sound.items() if any(pair := _pair(known.get("restart")))}
    return Memory(
        {name: _progress(known, now, known.get("boot") == boot) for name, known in sound.items()}, restarts=due
    )


def _sound(known: Any) -> bool:
    return isinstance(known, Mapping) and isinstance(known.get("needs"), Mapping)


def _progress(known: Mapping[str, Any], now: float, same_boot: bool) -> Progress:
    said = defaultdict(str, {key: value for key, value in known.items() if isinstance(value, str)})
    update = Update(
        edition=said["edition"],
        quarantined=_texts(known.get("quarantined")),
        rejected=said["rejected"],
        spared=said["spared"],
        crashing=_texts(known.get("crashing")),
        drawn=said["drawn"],
        interrupted=_count(known.get("interrupted")),
        proven=said["proven"],
        baked=said["baked"],
        well=said["well"],
        last_good=_last_good(known.get("last_good")),
        begun=_texts(known.get("reads")) or None,
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
        unwanted_since=_past(known.get("unwanted_since"), now, same_boot),
        ceased_since=_past(known.get("ceased_since"), now, same_boot),
        rebooted=not same_boot,
    )
    tries = _tries(known.get("tries"), now)
    if not same_boot or not (tries or known.get("exits")):
        return step
    return replace(step, exits=_count(known.get("exits")), error=said["said"], attempts=tries)


def _stopped(known: Mapping[str, Any]) -> tuple[str, ...]:
    """An older rorg remembered only the last one."""
    before = known.get("stopped_before")
    runs = [*(before if isinstance(before, list) else ()), known.get("stopped")]
    return tuple(run for run in runs if isinstance(run, str) and run)[-MOST_STOPPED:]


def _last_good(known: Any) -> LastGood | None:
    with suppress(KeyError, TypeError, ValueError):
        return LastGood(_text(known["digest"]), _probe(known["ready"]), _probe(known["live"])) if known else None
    return None


def _probe(known: Any) -> Probe | None:
    """Raises KeyError, TypeError or ValueError if it is no probe."""
    if known is None:
        return None
    target = known["target"]
    if not isinstance(target, str | int | float | list):
        raise TypeError("a probe has a target")
    return Probe(
        kind=_text(known["kind"]),
        target=tuple(map(_text, target)) if isinstance(target, list) else target,
        timeout=float(known["timeout"]),
        interval=float(known["interval"]),
        failures=_count(known["failures"]),
        graph=_text(known["graph"]),
        parts=tuple(part for each in known["parts"] if (part := _probe(each))),
    )


def _texts(known: Any) -> dict[str, str]:
    return {str(k): str(v) for k, v in known.items()} if isinstance(known, Mapping) else {}


def _pair(known: Any) -> tuple[str, str]:
    return (_text(known[0]), _text(known[1])) if isinstance(known, list) and len(known) == 2 else ("", "")


def _past(at: Any, now: float, same_boot: bool) -> float | None:
    return (min(now, float(at)) if same_boot else now) if isinstance(at, int | float) else None


def _tries(known: Any, now: float) -> dict[str, Attempt]:
    attempts = {}
    for verb, said in known.items() if isinstance(known, Mapping) else ():
        if not (isinstance(said, list) and len(said) == 4 and isinstance(said[2], int | float)):
            continue
        signature, count, at, error = said
        if isinstance(signature, list):
            due = min(now + CAP, float(at)) if at else 0.0
            attempts[str(verb)] = Attempt(tuple(map(_text, signature)), _count(count), due, _text(error))
    return attempts


def _count(value: Any) -> int:
    return value if type(value) is int and value >= 0 else 0


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ""
