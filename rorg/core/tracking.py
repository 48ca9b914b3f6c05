"""Track the progress of services from pass to pass: runs, exits, readiness, trials. Only services that may have changed
are reviewed, so that the cost of a pass grows with the changes, not with the number of services.

Reviewed are services whose containers, probe results, memory or calls under way changed, and those whose progress
depends on the time.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial

from rorg.core.atomic import freed, judged_together, sets_of
from rorg.core.changes import changed_keys
from rorg.core.desired import Desired
from rorg.core.memory import Memory, ProbeResults, Progress
from rorg.core.observed import Observed
from rorg.core.rollout import judged, renewed
from rorg.core.ros_parameters import ROLE, parameters_noted
from rorg.core.transitions import Evidence, advanced
from rorg.core.wanted import Wanted
from rorg.model.catalog import Service
from rorg.model.objects import is_object


@dataclass(frozen=True, slots=True, kw_only=True)
class Tracked:
    """Inputs and result of the last review."""

    desired: Desired
    wanted: Wanted
    results: ProbeResults
    in_flight: Collection[str]
    booted_at: str
    unplugged: frozenset[str]
    progress: Mapping[str, Progress]
    volatile: frozenset[str]
    """Services to review in every pass: their progress has just changed, or changes with the time."""


def track(
    kept: Tracked | None,
    memory: Memory,
    desired: Desired,
    wanted: Wanted,
    observed: Observed,
    results: ProbeResults,
    now: float,
    booted_at: str,
    touched: Collection[str],
    unplugged: Collection[str] = (),
) -> tuple[Memory, Tracked]:
    """Update the progress of services.

    `touched` are services whose containers changed since the last pass, `unplugged` those with a missing device. Call
    it only for a complete observation; renew_all() is for incomplete ones.
    """
    services, by_service = desired.catalog.services, observed.by_service()
    unchanged = kept is not None and kept.desired is desired and kept.wanted is wanted and kept.booted_at == booted_at
    if kept is None or not unchanged or any(n not in desired.digests for n in touched):
        kept, names = None, set(desired.digests)
    else:
        names = _to_review(kept, memory, desired, results, touched) | (kept.unplugged ^ set(unplugged))
    gone = memory.progress.keys() - desired.digests.keys() - by_service.keys()
    progress = {n: p for n, p in memory.progress.items() if n not in gone or (is_object(n) and p.attempts)}
    volatile = set(kept.volatile) if kept else set[str]()
    changed = len(progress) != len(memory.progress)
    snapshot = partial(Evidence, observed=observed, now=now, booted_at=booted_at)
    for name in names:
        service, last = services[name], memory.of(name)
        evidence = snapshot(
            wanted=name in wanted,
            ready=results.get((name, "ready")),
            live=results.get((name, "live")),
            busy=name in memory.in_flight,
            unplugged=name in unplugged,
        )
        progress_now = _reviewed(parameters_noted(last, results.get((name, ROLE))), service, desired, evidence)
        if not (unchanged := progress_now is last and name in memory.progress):
            progress[name], changed = progress_now, True
        (volatile.discard if unchanged and not _time_dependent(progress_now, service, evidence) else volatile.add)(name)
    set_changes = judged_together(sets_of(names, desired), progress, desired, wanted, observed)
    volatile |= set_changes.keys()
    memory = replace(memory, progress={**progress, **set_changes}) if changed or set_changes else memory
    tracked = Tracked(
        desired=desired,
        wanted=wanted,
        results=results,
        in_flight=frozenset(memory.in_flight),
        booted_at=booted_at,
        unplugged=frozenset(unplugged),
        progress=memory.progress,
        volatile=frozenset(volatile),
    )
    return memory, tracked


def renew_all(memory: Memory, desired: Desired, now: float) -> Memory:
    """Note new editions while the engine does not answer: manifests are known, containers are not."""
    progress = {name: renewed(memory.of(name), edition, now) for name, edition in desired.editions.items()}
    return replace(memory, progress={**memory.progress, **progress})


def _to_review(
    kept: Tracked, memory: Memory, desired: Desired, results: ProbeResults, touched: Collection[str]
) -> set[str]:
    """Return the services to review."""
    names = changed_keys(kept.progress, memory.progress)
    names |= {name for name, _ in changed_keys(kept.results, results) | (kept.results.keys() - results.keys())}
    names |= kept.in_flight ^ memory.in_flight.keys()
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
    return judged(progress, service, desired, evidence)


def _time_dependent(progress: Progress, service: Service, evidence: Evidence) -> bool:
    """Return whether progress may change with the time alone. It must cover every comparison with the clock in
    advanced() and judged()."""
    if progress.relied_on and not progress.ready:
        return True
    if progress.exits or progress.doubted_since is not None or len(evidence.observed.of(service.name)) > 1:
        return True
    if evidence.wanted and progress.running_since is not None and progress.update.baked != progress.update.edition:
        return True
    by_time = service.ready is not None and service.ready.delay is not None
    return by_time and progress.running_since is not None and not progress.ready
