"""Atomic sets: services that change together (`update: {atomic: NAME}`). No new container takes its place before all of
the set's new containers exist, none is proven before all are, and if one change fails, all go back.

The verdict is noted with each service of a set, so that the plan of one service does not depend on the plans of others.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from rorg.core.desired import Desired
from rorg.core.memory import NONE, STALLED_AFTER, Progress
from rorg.core.observed import Observed
from rorg.core.probes_in_force import fits
from rorg.core.trial import candidate
from rorg.core.update import Update
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
    sets: Iterable[str], progress: Mapping[str, Progress], desired: Desired, wanted: Collection[str], observed: Observed
) -> dict[str, Progress]:
    """Return the services of these sets whose progress changes, with the new progress."""
    judge = _Judge(progress, desired, wanted, observed)
    return {name: changed for set_name in sets for name, changed in judge.judged(desired.sets[set_name])}


class _Judge:
    """Judges the sets of one pass."""

    def __init__(
        self, progress: Mapping[str, Progress], desired: Desired, wanted: Collection[str], observed: Observed
    ) -> None:
        self.progress, self.desired, self.wanted, self.observed = progress, desired, wanted, observed

    def judged(self, members: Sequence[str]) -> Iterator[tuple[str, Progress]]:
        """Return the members of one set whose progress changes."""
        known = {n: self.progress.get(n, NONE) for n in members}
        changing = {n: c for n in members if (c := self.changing(n, known[n].update))}
        awaited = [c for c in changing.values() if c.wanted]
        failures = {n: why for n, p in known.items() if (why := p.update.quarantined.get(p.update.edition, ""))}
        unprepared = next((c.name for c in awaited if not c.new), "")
        proven = not failures and all(c.new and c.baked for c in awaited)
        for member, own in known.items():
            change, update = changing.get(member), replace(own.update, drawn="", held="")
            if change and failures and member not in failures and not _hopeless(change, own):
                other = next(iter(failures))
                why = f"it changes together with {other}, whose change failed: {failures[other]}"
                update = replace(update, drawn=why)
            elif change and change.wanted and unprepared and not failures:
                update = replace(update, held=unprepared)
            elif change and change.wanted and proven:
                update = replace(update, proven=change.new)
            if update.drawn and not own.update.drawn:
                own = replace(own, exits=0, attempts={}, error="")  # the previous container starts without back-off
            if update != own.update:
                yield member, replace(own, update=update)

    def changing(self, name: str, update: Update) -> _Changing | None:
        """Return how far the change of a service is; None if it matches its manifest or has nothing to go back to."""
        containers, wanted = self.observed.of(name), name in self.wanted
        pair = candidate(containers, update)
        if pair and fits(pair[0], name, self.desired):
            return _Changing(name, wanted, pair[0].id, update.is_proven(pair[0].id))
        new = next((c for c in containers if fits(c, name, self.desired)), None)
        if not containers or (new and not containers[0].alive) or new is containers[0]:
            return None
        # The change was reverted while on trial: the previous container matches again but is not yet in use.
        return _Changing(name, wanted, new.id if new else "", False)


def _hopeless(change: _Changing, progress: Progress) -> bool:
    """Return whether the service does not run as it was either. There is nothing to go back to, so its change is made
    alone."""
    return not change.new and progress.exits >= STALLED_AFTER
