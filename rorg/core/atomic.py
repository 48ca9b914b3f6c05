"""Atomic sets: services that change together (`update: {atomic: NAME}`). No new container takes its place before all of
the set's new containers exist, none is proven before all are, and if one change fails, all go back.

The verdict is noted with each service of a set, so that the plan of one service does not depend on the plans of others.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from rorg.core.desired import Desired
from rorg.core.memory import NONE, STALLED_AFTER, Progress
from rorg.core.observed import Container
from rorg.core.rollout import candidate, fits
from rorg.model.catalog import Service


@dataclass(frozen=True, slots=True)
class _Changing:
    """A service of a set that differs from its manifest, or is not yet proven to match it. `new` is the id of its new
    container, "" if there is none."""

    name: str
    wanted: bool
    new: str
    baked: bool


def sets_of(names: Iterable[str], desired: Desired) -> set[str]:
    """Return the sets that these services belong to."""
    services = desired.catalog.services
    return {set_name for n in names if (set_name := services[n].update.atomic) in desired.sets}


def freed(progress: Progress, service: Service, desired: Desired) -> Progress:
    """Return the progress of a service that no longer belongs to a set."""
    update = progress.update
    if not (update.drawn or update.held) or service.update.atomic in desired.sets:
        return progress
    return replace(progress, update=replace(update, drawn="", held=""))


def judged_together(
    sets: Iterable[str],
    progress: Mapping[str, Progress],
    desired: Desired,
    wanted: Collection[str],
    containers: Mapping[str, Sequence[Container]],
) -> dict[str, Progress]:
    """Return the services of these sets whose progress changes, with the new progress."""
    changed_progress: dict[str, Progress] = {}
    for name in sets:
        changed_progress |= _judged(desired.sets[name], progress, desired, wanted, containers)
    return changed_progress


def _judged(
    members: Sequence[str],
    progress: Mapping[str, Progress],
    desired: Desired,
    wanted: Collection[str],
    containers: Mapping[str, Sequence[Container]],
) -> dict[str, Progress]:
    changing = {n: c for n in members if (c := _changing(n, progress, desired, wanted, containers.get(n, ())))}
    awaited = [c for c in changing.values() if c.wanted]
    failures = {n: why for n in members if (why := _own(progress, n))}
    unprepared = next((c.name for c in awaited if not c.new), "")
    proven = not failures and all(c.new and c.baked for c in awaited)
    changed_progress = {}
    for member in members:
        own, change = progress.get(member, NONE), changing.get(member)
        update = replace(own.update, drawn="", held="")
        if change and failures and member not in failures and not _hopeless(change, own):
            other = next(iter(failures))
            update = replace(update, drawn=f"it changes together with {other}, whose change failed: {failures[other]}")
        elif change and change.wanted and unprepared and not failures:
            update = replace(update, held=unprepared)
        elif change and change.wanted and proven:
            update = replace(update, proven=change.new)
        if update.drawn and not own.update.drawn:
            own = replace(own, exits=0, attempts={}, error="")  # the previous container starts without back-off
        if update != own.update:
            changed_progress[member] = replace(own, update=update)
    return changed_progress


def _hopeless(change: _Changing, progress: Progress) -> bool:
    """Return whether the service does not run as it was either. There is nothing to go back to, so its change is made
    alone."""
    return not change.new and progress.exits >= STALLED_AFTER


def _own(progress: Mapping[str, Progress], name: str) -> str:
    changes = progress.get(name, NONE).update
    return changes.quarantined.get(changes.edition, "")


def _changing(
    name: str,
    progress: Mapping[str, Progress],
    desired: Desired,
    wanted: Collection[str],
    containers: Sequence[Container],
) -> _Changing | None:
    """Return how far the change of a service is; None if it matches its manifest or has nothing to go back to."""
    update = progress.get(name, NONE).update
    pair = candidate(containers, update) if len(containers) > 1 else None
    if pair and fits(pair[0], name, desired):
        return _Changing(name, name in wanted, pair[0].id, update.baked == update.edition)
    new = next((c for c in containers if fits(c, name, desired)), None)
    if not containers or (new and not containers[0].alive) or new is containers[0]:
        return None
    # The change was reverted while on trial: the previous container matches again but is not yet in use.
    return _Changing(name, name in wanted, new.id if new else "", False)
