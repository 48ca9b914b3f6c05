"""Requested restarts: each ends the run that was going on, and is done when another run has begun."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from rorg.core.memory import Due, Memory
from rorg.core.observed import Observed


def note_restarts(
    memory: Memory, asked: Mapping[str, str], observed: Observed, wall: str
) -> tuple[Memory, Mapping[str, str]]:
    """Return which run each due restart must end, and the restarts that are done. `asked` says when each was requested,
    `wall` is the present time (both ISO 8601, UTC).

    Runs are compared by incarnation, so a clock that is set or differs from the engine's restarts nothing twice. Times
    decide only about restarts from before this rorg began.
    """
    if not observed.complete:
        return memory, {}
    known, due, done, begun = memory.restarts or {}, {}, {}, []
    for name, stamp in asked.items():
        if stamp > wall:
            continue
        current = observed.current(name)
        if current and current.brief:
            due.update({name: known[name]} if name in known else {})
            continue
        run = current.incarnation if current else ""
        if name in known and known[name].stamp == stamp:
            due[name] = known[name]
        elif memory.restarts is None and current and current.started_at >= stamp:
            done[name] = stamp
            continue
        else:
            due[name] = Due(stamp, run)
            begun.append(name)
        if current and current.alive and run != due[name].run:
            done[name] = stamp
            del due[name]
    # Who asks for a restart wants it now, without the back-off of earlier failures.
    progress = {**memory.progress, **{n: memory.of(n).start_forgotten() for n in begun}} if begun else memory.progress
    return (memory if due == memory.restarts else replace(memory, restarts=due, progress=progress)), done
