"""What is remembered of each service, followed from pass to pass. Only services that may be otherwise than at the last
look are looked at: those whose containers, calls under way, probe results or memory have changed, and those whose
memory changes with the time alone."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial

from rorg.core.atomic import freed, judged_together, sets_of
from rorg.core.changes import changed_keys
from rorg.core.content import noted
from rorg.core.desired import Desired
from rorg.core.memory import Memory, ProbeResults, Progress
from rorg.core.observed import Observed
from rorg.core.rollout import judged, renewed
from rorg.core.ros_parameters import ROLE, parameters_noted
from rorg.core.seen import Seen
from rorg.core.transitions import advanced
from rorg.core.wanted import Wanted
from rorg.model.catalog import Service
from rorg.model.objects import is_object


@dataclass(frozen=True, slots=True, kw_only=True)
class Followed:
    """What the last look went by, and what it found."""

    desired: Desired
    wanted: Wanted
    results: ProbeResults
    in_flight: Collection[str]
    booted_at: str
    unplugged: frozenset[str]
    progress: Mapping[str, Progress]
    restless: frozenset[str]
    """Services whose memory another look might change though nothing else has: it has just changed, or does so with the
    time alone."""


def follow(
    kept: Followed | None,
    memory: Memory,
    desired: Desired,
    wanted: Wanted,
    observed: Observed,
    results: ProbeResults,
    now: float,
    booted_at: str,
    touched: Collection[str],
    unplugged: Collection[str] = (),
) -> tuple[Memory, Followed]:
    """Takes note of what is wanted and observed now. `touched` are services whose containers are others, or otherwise,
    than at the last look; `unplugged` those of which a device is not there. Of a complete observation."""
    services, by_service = desired.catalog.services, observed.by_service()
    same = kept is not None and kept.desired is desired and kept.wanted is wanted and kept.booted_at == booted_at
    if kept is None or not same or any(n not in desired.digests for n in touched):
        kept, names = None, set(desired.digests)
    else:
        names = _to_look_at(kept, memory, desired, results, touched) | (kept.unplugged ^ set(unplugged))
    gone = memory.progress.keys() - desired.digests.keys() - by_service.keys()
    progress = {n: p for n, p in memory.progress.items() if n not in gone or (is_object(n) and p.attempts)}
    restless = set(kept.restless) if kept else set[str]()
    changed = len(progress) != len(memory.progress)
    look = partial(Seen, containers=by_service, now=now, booted_at=booted_at, looked=observed.looked)
    for name in names:
        service, before = services[name], memory.of(name)
        seen = look(
            wanted=name in wanted,
            ready=results.get((name, "ready")),
            live=results.get((name, "live")),
            busy=name in memory.in_flight,
            unplugged=name in unplugged,
        )
        step = _one(parameters_noted(before, results.get((name, ROLE))), service, desired, seen)
        if not (same := step is before and name in memory.progress):
            progress[name], changed = step, True
        (restless.discard if same and not _changes_by_itself(step, service, seen) else restless.add)(name)
    together = judged_together(sets_of(names, desired), progress, desired, wanted, by_service)
    restless |= together.keys()
    memory = replace(memory, progress={**progress, **together}) if changed or together else memory
    followed = Followed(
        desired=desired,
        wanted=wanted,
        results=results,
        in_flight=frozenset(memory.in_flight),
        booted_at=booted_at,
        unplugged=frozenset(unplugged),
        progress=memory.progress,
        restless=frozenset(restless),
    )
    return memory, followed


def renew_all(memory: Memory, desired: Desired, now: float) -> Memory:
    """While it is not known what is there: only what the manifests say is taken note of."""
    progress = {name: renewed(memory.of(name), edition, now) for name, edition in desired.editions.items()}
    return replace(memory, progress={**memory.progress, **progress})


def _to_look_at(
    kept: Followed, memory: Memory, desired: Desired, results: ProbeResults, touched: Collection[str]
) -> set[str]:
    names = changed_keys(kept.progress, memory.progress)
    names |= {name for name, _ in changed_keys(kept.results, results) | (kept.results.keys() - results.keys())}
    names |= kept.in_flight ^ memory.in_flight.keys()
    names.update(touched, kept.restless)
    for name in touched:
        names.update(desired.dependants[name])
    return names & desired.digests.keys()


def _one(step: Progress, service: Service, desired: Desired, seen: Seen) -> Progress:
    name = service.name
    step = advanced(freed(renewed(step, desired.editions[name], seen.now), service, desired), service, seen)
    current = seen.current(name)
    if name in desired.contents and current is not None:
        step = noted(step, current, desired.contents[name])
    return judged(step, service, desired, seen)


def _changes_by_itself(step: Progress, service: Service, seen: Seen) -> bool:
    """As far as advanced() and judged() look at the time."""
    if step.relied_on and not step.ready:
        return True
    if step.exits or step.doubted_since is not None or len(seen.containers.get(service.name, ())) > 1:
        return True
    if seen.wanted and step.running_since is not None and step.update.baked != step.update.edition:
        return True
    by_time = service.ready is not None and service.ready.delay is not None
    return by_time and step.running_since is not None and not step.ready
