"""What a run has read of the files that it mounts from the tree, and what of it has changed since."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from rorg.core.desired import Desired
from rorg.core.memory import Memory
from rorg.core.observed import Container, Observed
from rorg.core.update import Update


def note_content(memory: Memory, desired: Desired, observed: Observed) -> Memory:
    """Of a run that we began, it is what was there then. Of one that is new to us, it is taken to be what is there
    now: a new rorg restarts nothing by itself."""
    if not observed.complete:
        return memory
    progress = {}
    for name, there in desired.contents.items():
        current = next(iter(observed.by_service().get(name, ())), None)
        if current is None or not current.alive or current.brief:
            continue
        step = memory.of(name)
        update = _noted(step.update, current, there)
        if update != step.update:
            progress[name] = replace(step, update=update)
    return replace(memory, progress={**memory.progress, **progress}) if progress else memory


def _noted(update: Update, current: Container, there: Mapping[str, str]) -> Update:
    if update.run != current.incarnation:
        begun = there if update.begun is None else update.begun
        return replace(
            update, run=current.incarnation, content={p: begun.get(p, d) for p, d in there.items()}, begun=None
        )
    if update.content.keys() != there.keys():
        return replace(update, content={p: update.content.get(p, d) for p, d in there.items()})
    return update


def changed(update: Update, container: Container, there: Mapping[str, str]) -> tuple[str, ...]:
    """Mounted paths whose content is another one than this run has read."""
    if update.run != container.incarnation:
        return ()
    return tuple(sorted(p for p, digest in there.items() if update.content.get(p, digest) != digest))
