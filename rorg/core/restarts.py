"""Restarts that somebody asked for: each ends the one run that was going on, and is done when another has begun."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from rorg.core.memory import Due, Memory, Progress
from rorg.core.observed import Observed


def note_restarts(
    memory: Memory, asked: Mapping[str, str], observed: Observed, wall: str
) -> tuple[Memory, Mapping[str, str]]:
    """Which run is to end by each restart whose time has come, and the restarts that are done. `asked` says when each
    was asked for, `wall` what time it is (both ISO 8601, UTC).

    A run is told by its incarnation, so a clock that was set, or is another one than the engine's, restarts nothing
    twice. Only of restarts that were there before this rorg began must the times tell whether they were done.
    """
    if not observed.complete:
        return memory, {}
    containers = observed.by_service()
    known, due, done, begun = memory.restarts or {}, {}, {}, []
    for name, stamp in asked.items():
        if stamp > wall:
            continue
        current = next(iter(containers.get(name, [])), None)
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
    progress = {**memory.progress, **{name: _at_once(memory.of(name)) for name in begun}} if begun else memory.progress
    return (memory if due == memory.restarts else replace(memory, restarts=due, progress=progress)), done


def _at_once(step: Progress) -> Progress:
    """Whoever asks for a restart does not wait for an earlier failure's back-off."""
    return step.start_forgotten()
