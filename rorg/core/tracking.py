"""Track the progress of services from pass to pass: runs, exits, readiness, trials. Only services that may have changed
are reviewed, so that the cost of a pass grows with the changes, not with the number of services.

Reviewed are services whose containers, probe results, memory or calls under way changed, and those whose progress
depends on the time.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

from rorg.core.atomic import freed, judged_together, sets_of
from rorg.core.changes import changed_keys
from rorg.core.desired import Desired
from rorg.core.memory import Memory, ProbeResults, Progress
from rorg.core.observed import Observed
from rorg.core.rollout import judged, renewed
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
    booted_at: str
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
            booted_at=self.booted_at,
            unplugged=name in self.unplugged,
        )


@dataclass(frozen=True, slots=True)
class Tracked:
    """The facts of the last review, with the memory after it."""

    facts: Facts
    volatile: frozenset[str]
    """Services to review in every pass: their progress has just changed, or changes with the time."""


def track(kept: Tracked | None, facts: Facts, touched: Collection[str]) -> Tracked:
    """Update the progress of services. `touched` are services whose containers changed since the last pass. Call it
    only for a complete observation; renew_all() is for incomplete ones."""
    memory, desired = facts.memory, facts.desired
    if kept and not _comparable(kept.facts, facts, touched):
        kept = None
    names = _to_review(kept, facts, touched) if kept else set(desired.digests)
    gone = memory.progress.keys() - desired.digests.keys() - facts.observed.by_service().keys()
    progress = {n: p for n, p in memory.progress.items() if n not in gone or (is_object(n) and p.attempts)}
    volatile = set(kept.volatile) if kept else set[str]()
    changed = len(progress) != len(memory.progress)
    for name in names:
        service, last, evidence = desired.catalog.services[name], memory.of(name), facts.evidence(name)
        progress_now = _reviewed(parameters_noted(last, facts.results.get((name, ROLE))), service, desired, evidence)
        if not (unchanged := progress_now is last and name in memory.progress):
            progress[name], changed = progress_now, True
        (volatile.discard if unchanged and not _time_dependent(progress_now, service, evidence) else volatile.add)(name)
    set_changes = judged_together(sets_of(names, desired), progress, desired, facts.wanted, facts.observed)
    volatile |= set_changes.keys()
    memory = replace(memory, progress={**progress, **set_changes}) if changed or set_changes else memory
    return Tracked(replace(facts, memory=memory), frozenset(volatile))


def _comparable(before: Facts, now: Facts, touched: Collection[str]) -> bool:
    """Return whether everything that concerns all services is as it was."""
    same = before.desired is now.desired and before.booted_at == now.booted_at
    elsewhere = {**before.observed.elsewhere, **now.observed.elsewhere}
    return same and all(n in now.desired.digests or n in elsewhere for n in touched)


def renew_all(memory: Memory, desired: Desired, now: float) -> Memory:
    """Note new editions while the engine does not answer: manifests are known, containers are not."""
    progress = {name: renewed(memory.of(name), edition, now) for name, edition in desired.editions.items()}
    return replace(memory, progress={**memory.progress, **progress})


def _to_review(kept: Tracked, facts: Facts, touched: Collection[str]) -> set[str]:
    """Return the services to review."""
    before, desired = kept.facts, facts.desired
    names = changed_keys(before.memory.progress, facts.memory.progress)
    results = changed_keys(before.results, facts.results) | (before.results.keys() - facts.results.keys())
    names |= {name for name, _ in results}
    names |= before.memory.in_flight.keys() ^ facts.memory.in_flight.keys()
    names |= {*before.unplugged} ^ {*facts.unplugged}
    names |= before.wanted.keys() ^ facts.wanted.keys()
    names.update(touched, kept.volatile)
    for name in touched:
        names.update(desired.dependants[name])
    return names & desired.digests.keys()


def _reviewed(progress: Progress, service: Service, desired: Desired, evidence: Evidence) -> Progress:
    """Return the progress of one service after this pass."""
    name = service.name
    progress = advanced(
        freed(renewed(progress, desired.editions[name], evidence.now), service, desired), service, evidence
    )
    current = evidence.observed.current(name)
    if name in desired.contents and current is not None:
        update = progress.update.noting(current, desired.contents[name])
        progress = progress if update == progress.update else replace(progress, update=update)
    if name in desired.ros:
        progress = begun_with(progress, service, current, desired.ros[name])
    return judged(progress, service, desired, evidence)


def _time_dependent(progress: Progress, service: Service, evidence: Evidence) -> bool:
    """Return whether progress may change with the time alone. It must cover every comparison with the clock in
    advanced() and judged()."""
    if progress.relied_on and not progress.ready:
        return True
    if progress.doubted_since is not None or len(evidence.observed.of(service.name)) > 1:
        return True
    if progress.exits and progress.running_since is not None:  # a stable run forgets them
        return True
    if evidence.wanted and progress.running_since is not None and progress.update.baked != progress.update.edition:
        return True
    by_time = service.ready is not None and service.ready.delay is not None
    return by_time and progress.running_since is not None and not progress.ready
