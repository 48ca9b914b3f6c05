"""What a run has read of the files that it mounts from the tree, and what of it has changed since."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from rorg.core.memory import Progress
from rorg.core.observed import Container
from rorg.core.update import Update


def noted(step: Progress, current: Container, there: Mapping[str, str]) -> Progress:
    """Of a run that we began, it is what was there then. Of one that is new to us, it is taken to be what is there
    now: a new rorg restarts nothing by itself. `there` is what is there now."""
    if not current.alive or current.brief:
        return step
    update = _noted(step.update, current, there)
    return step if update == step.update else replace(step, update=update)


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
