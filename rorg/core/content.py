"""Which content of mounted files a run has read, and what has changed since. Editing a mounted config file must reload
the service that read it, and only that one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from rorg.core.memory import Progress
from rorg.core.observed import Container
from rorg.core.update import Update


def noted(progress: Progress, current: Container, present: Mapping[str, str]) -> Progress:
    """Note what the current run has read. A run that rorg started has read what was there at the start. For a run that
    rorg finds at its own start, the present content is assumed, because a new rorg must restart nothing on its own.
    `there` maps mounted paths to present digests."""
    if not current.alive or current.brief:
        return progress
    update = _noted(progress.update, current, present)
    return progress if update == progress.update else replace(progress, update=update)


def _noted(update: Update, current: Container, present: Mapping[str, str]) -> Update:
    if update.run != current.incarnation:
        begun = present if update.begun is None else update.begun
        return replace(
            update, run=current.incarnation, content={p: begun.get(p, d) for p, d in present.items()}, begun=None
        )
    if update.content.keys() != present.keys():
        return replace(update, content={p: update.content.get(p, d) for p, d in present.items()})
    return update


def changed(update: Update, container: Container, present: Mapping[str, str]) -> tuple[str, ...]:
    """Return mounted paths whose content differs from what this run has read."""
    if update.run != container.incarnation:
        return ()
    return tuple(sorted(p for p, digest in present.items() if update.content.get(p, digest) != digest))
