"""Track the progress of services from pass to pass: runs, exits, readiness, trials. Only services that may have changed
are reviewed, so that the cost of a pass grows with the changes, not with the number of services.

Reviewed are services whose containers, probe results, memory or calls under way changed, and those whose progress
depends on the time.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from math import inf

from rorg.core.atomic import freed, judged_together, sets_of
from rorg.core.changes import changed_keys, updated
from rorg.core.desired import Desired
from rorg.core.memory import Memory, ProbeResults, Progress
from rorg.core.observed import Observed
from rorg.core.probes_in_force import with_probes_in_force
from rorg.core.rollout import bake_ends_at, judged, mended_from, renewed
from rorg.core.ros_parameters import ROLE, begun_with, parameters_noted
from rorg.core.transitions import Evidence, advanced
from rorg.core.wanted import Wanted
from rorg.model.catalog import Service
from rorg.model.objects import is_object


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """The facts that a review rests on. `unplugged` are services with a missing device."""

    memory: Memory
    desired: Desired
    wanted: Wanted
    observed: Observed
    results: ProbeResults
    now: float
    unplugged: Collection[str]

    def evidence(self, name: str) -> Evidence:
        """Return what concerns one service."""
        return Evidence(
            wanted=name in self.wanted,
            observed=self.observed,
            ready=self.results.get((name, "ready")),
            live=self.results.get((name, "live")),
            busy=name in self.memory.in_flight,
            now=self.now,
            unplugged=name in self.unplugged,
            outage=bool(self.memory.outage),
        )


@dataclass(frozen=True, slots=True)
class Tracked:
    """The facts of the last review, with the memory after it."""

    facts: Facts
    due: Mapping[str, float]
    """Service -> when to review it although nothing else changes, by the loop's clock: in the next pass, since its
    progress has just changed, or when that changes with the time."""


def track(kept: Tracked | None, facts: Facts, touched: Collection[str]) -> Tracked:
    """Update the progress of services. `touched` are services whose containers changed since the last pass. Call it
    only for a complete observation; renew_all() is for incomplete ones."""
    memory, desired = facts.memory, facts.desired
    if kept and not _comparable(kept.facts, facts, touched):
        kept = None
    names = _to_review(kept, facts, touched) if kept else {*desired.digests, *memory.progress}
    changes, due = dict[str, Progress](), {**kept.due} if kept else dict[str, float]()
    gone, names = _gone(facts, names), names & desired.digests.keys()
    for name in names:
        service, last, evidence = desired.catalog.services[name], memory.of(name), facts.evidence(name)
        progress_now = _reviewed(parameters_noted(last, facts.results.get((name, ROLE))), service, desired, evidence)
        if not (unchanged := progress_now is last and name in memory.progress):
            changes[name] = progress_now
        due[name] = _changes_at(progress_now, service, evidence, desired) if unchanged else -inf
        if due[name] == inf:
            del due[name]
    progress = updated(memory.progress, changes, gone) if changes or gone else memory.progress
    if of_sets := judged_together(sets_of(names, desired), progress, desired, facts.wanted, facts.observed):
        progress, due = updated(progress, of_sets), due | dict.fromkeys(of_sets, -inf)
    if progress is not memory.progress or memory.outage is not False:
        memory = replace(memory, progress=progress, outage=False)
    return Tracked(replace(facts, memory=memory), due)


def _gone(facts: Facts, names: Iterable[str]) -> list[str]:
    """Return those of the subjects that are neither declared nor there. A network or volume is kept while it cannot be
    removed."""
    progress, digests, there = facts.memory.progress, facts.desired.digests, facts.observed.by_service()
    gone = (n for n in names if n in progress and n not in digests and n not in there)
    return [n for n in gone if not (is_object(n) and progress[n].attempts)]


def _comparable(before: Facts, now: Facts, touched: Collection[str]) -> bool:
    """Return whether everything that concerns all services is as it was."""
    elsewhere = {**before.observed.elsewhere, **now.observed.elsewhere}
    return before.desired is now.desired and all(n in now.desired.digests or n in elsewhere for n in touched)


def renew_all(memory: Memory, desired: Desired, now: float) -> Memory:
    """Note new editions while the engine does not answer: manifests are known, containers are not."""
    progress = {name: renewed(memory.of(name), edition, now) for name, edition in desired.editions.items()}
    return replace(memory, progress=updated(memory.progress, progress))


def _to_review(kept: Tracked, facts: Facts, touched: Collection[str]) -> set[str]:
    """Return the subjects to review. Some may have gone."""
    before, desired = kept.facts, facts.desired
    names = changed_keys(before.memory.progress, facts.memory.progress)
    results = changed_keys(before.results, facts.results) | (before.results.keys() - facts.results.keys())
    names |= {name for name, _ in results}
    names |= before.memory.in_flight.keys() ^ facts.memory.in_flight.keys()
    names |= {*before.unplugged} ^ {*facts.unplugged}
    names |= set() if before.wanted is facts.wanted else before.wanted.keys() ^ facts.wanted.keys()
    names.update(touched, (name for name, at in kept.due.items() if at <= facts.now))
    for name in touched:
        names.update(desired.dependants[name])
    return names


def _reviewed(progress: Progress, service: Service, desired: Desired, evidence: Evidence) -> Progress:
    """Return the progress of one service after this pass."""
    name = service.name
    current = evidence.observed.current(name)
    progress = freed(renewed(progress, desired.editions[name], evidence.now), service, desired)
    progress = advanced(progress, with_probes_in_force(service, progress.update, current, desired), evidence)
    if name in desired.contents:
        update = progress.update.noting(current, desired.contents[name])
        progress = progress if update == progress.update else replace(progress, update=update)
    if name in desired.ros:
        progress = begun_with(progress, service, current, desired.ros[name])
    return judged(progress, service, desired, evidence)


def _changes_at(progress: Progress, service: Service, evidence: Evidence, desired: Desired) -> float:
    """Return when progress may change with the time alone, inf for never. It must cover every comparison with the clock
    in advanced() and judged()."""
    if progress.relied_on and not progress.ready:
        return -inf
    if progress.doubted_since is not None or len(evidence.observed.of(service.name)) > 1:
        return -inf
    if progress.running_since is None:
        return inf
    if progress.exits:  # a stable run forgets them
        return -inf
    current = evidence.observed.current(service.name)
    if evidence.wanted and current is not None and not progress.update.is_proven(current.id):
        over = bake_ends_at(progress, service)
        return -inf if over is None else over
    if evidence.wanted and (mended_at := mended_from(progress, service)) is not None:
        return mended_at
    service = with_probes_in_force(service, progress.update, current, desired)
    by_time = service.ready is not None and service.ready.delay is not None
    return -inf if by_time and not progress.ready else inf
