"""Sets of services that change together: no new container takes its place before those of all are there, none is proven
before all are, and where the change of one fails, all go back.

What it comes to is noted with each service of a set, so that the plan of one depends on nothing of the others.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from rorg.core.backoff import STALLED_AFTER
from rorg.core.desired import Desired
from rorg.core.memory import NONE, Progress
from rorg.core.observed import Container
from rorg.core.rollout import candidate, fits
from rorg.model.catalog import Service


@dataclass(frozen=True, slots=True)
class _Changing:
    """A service of a set that is not as its manifest says, or is not proven to be. `new` is its new container's id."""

    name: str
    wanted: bool
    new: str
    baked: bool


def sets_of(names: Iterable[str], desired: Desired) -> set[str]:
    """The sets that these services belong to."""
    services = desired.catalog.services
    return {found for n in names if (found := services[n].update.atomic) in desired.sets}


def freed(step: Progress, service: Service, desired: Desired) -> Progress:
    """Of a service that belongs to no set any more."""
    update = step.update
    if not (update.drawn or update.held) or service.update.atomic in desired.sets:
        return step
    return replace(step, update=replace(update, drawn="", held=""))


def judged_together(
    sets: Iterable[str],
    progress: Mapping[str, Progress],
    desired: Desired,
    wanted: Collection[str],
    containers: Mapping[str, Sequence[Container]],
) -> dict[str, Progress]:
    """What is to be remembered otherwise of the services of these sets."""
    found: dict[str, Progress] = {}
    for name in sets:
        found |= _judged(desired.sets[name], progress, desired, wanted, containers)
    return found


def _judged(
    members: Sequence[str],
    progress: Mapping[str, Progress],
    desired: Desired,
    wanted: Collection[str],
    containers: Mapping[str, Sequence[Container]],
) -> dict[str, Progress]:
    changing = {n: c for n in members if (c := _changing(n, progress, desired, wanted, containers.get(n, ())))}
    awaited = [c for c in changing.values() if c.wanted]
    bad = {n: why for n in members if (why := _own(progress, n))}
    unprepared = next((c.name for c in awaited if not c.new), "")
    proven = not bad and all(c.new and c.baked for c in awaited)
    found = {}
    for member in members:
        step, one = progress.get(member, NONE), changing.get(member)
        update = replace(step.update, drawn="", held="")
        if one and bad and member not in bad and not _hopeless(one, step):
            other = next(iter(bad))
            update = replace(update, drawn=f"it goes together with {other}, whose change failed: {bad[other]}")
        elif one and one.wanted and unprepared and not bad:
            update = replace(update, held=unprepared)
        elif one and one.wanted and proven:
            update = replace(update, proven=one.new)
        if update.drawn and not step.update.drawn:
            step = replace(step, exits=0, attempts={}, error="")  # what it goes back to begins afresh
        if update != step.update:
            found[member] = replace(step, update=update)
    return found


def _hopeless(one: _Changing, step: Progress) -> bool:
    """It does not run as it was: there is nothing to go back to, so it goes on alone."""
    return not one.new and step.exits >= STALLED_AFTER


def _own(progress: Mapping[str, Progress], name: str) -> str:
    update = progress.get(name, NONE).update
    return update.quarantined.get(update.edition, "")


def _changing(
    name: str,
    progress: Mapping[str, Progress],
    desired: Desired,
    wanted: Collection[str],
    containers: Sequence[Container],
) -> _Changing | None:
    """None for a service that is as it is to be, or has nothing to go back to."""
    update = progress.get(name, NONE).update
    pair = candidate(containers, update) if len(containers) > 1 else None
    if pair and fits(pair[0], name, desired):
        return _Changing(name, name in wanted, pair[0].id, update.baked == update.edition)
    new = next((c for c in containers if fits(c, name, desired)), None)
    if not containers or (new and not containers[0].alive) or new is containers[0]:
        return None
    # What was changed back while its change was on trial: the container before is there, and not yet in use.
    return _Changing(name, name in wanted, new.id if new else "", False)
