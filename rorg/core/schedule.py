"""When the loop must run again without an event, and what to probe until then."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from math import ceil
from typing import Any

from rorg.core.desired import Desired
from rorg.core.digest import rules_of
from rorg.core.incremental import Planned, busy
from rorg.core.memory import Progress
from rorg.core.observed import Container, Observed
from rorg.core.rollout import bake_ends_at, is_late_at, mended_from
from rorg.core.ros_parameters import AGAIN, LONGEST, ROLE, due, probe_of
from rorg.core.situation import Situation
from rorg.core.transitions import doubt_ends
from rorg.model.codes import PARAMETERS
from rorg.model.probe import Probe


@dataclass(frozen=True, slots=True)
class Target:
    """A probe to run until told otherwise. Equal targets ask the same question."""

    probe: Probe
    incarnation: str
    every: float
    container: Container | None = field(default=None, compare=False)
    asked: float | None = field(default=None, compare=False)
    """Someone, or a verdict, waits for an answer to a question asked since then."""
    values: Mapping[str, Any] = field(default_factory=dict, compare=False)
    """ROS parameters to set; the probe identifies which ones."""
    anew: bool = False
    """Set them even if the master has them."""
    longest: float = 0.0
    """Upper limit in seconds for doubling the interval after failures; 0 for no doubling."""

    def next_after(self, failures: int) -> float:
        """Return seconds until the next attempt after this many consecutive failures."""
        doubled = self.every * 2.0 ** min(max(failures - 1, 0), 10)
        return min(doubled, max(self.every, self.longest))

    part: int = 0
    """Index of the probe's question."""

    def parts(self) -> tuple[Target, ...]:
        """Return one target per question of the probe, each at its own interval but not faster than this one."""
        if not self.probe.parts:
            return (self,)
        return tuple(
            replace(self, probe=probe, every=max(probe.interval, self.every), part=index)
            for index, probe in enumerate(self.probe.parts)
        )


Targets = Mapping[tuple[str, str], Target]
"""By (service, role)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Schedule:
    """`asked`: service -> since when someone waits for it."""

    times: Mapping[str, tuple[float, ...]]
    """Service -> times at which something may be due, by the loop's clock."""
    targets: Targets
    looks: Mapping[str, tuple[str, float]]
    """Service -> the container that must be looked at after this moment, because a verdict waits for it."""
    asked: Mapping[str, float]
    engaged: bool
    """Whether pressure measures were in force or services were shed."""

    def next(self, now: float) -> float | None:
        return min((at for times in self.times.values() for at in times if at > now), default=None)


def schedule(kept: Schedule | None, planned: Planned, asked: Mapping[str, float]) -> Schedule:
    """Return the schedule, recomputed only for services that were planned in this pass or whose waiters changed."""
    situation = planned.situation
    engaged = situation.memory.pressure.engaged
    names: Collection[str] = planned.replanned
    if kept is None or planned.whole or kept.engaged != engaged:
        times, targets, looks, names = {}, {}, {}, planned.names
    else:
        times, targets, looks = {**kept.times}, {**kept.targets}, {**kept.looks}
        names = {
            *names,
            *(n for n in {*asked, *kept.asked} if asked.get(n) != kept.asked.get(n) and n in planned.places),
        }
    for name in names:
        due_times = times_of(situation, name, planned)
        if due_times:
            times[name] = due_times
        else:
            times.pop(name, None)
        for role in ("ready", "live", "interlock", ROLE):
            targets.pop((name, role), None)
        targets |= {(name, role): target for role, target in targets_of(planned, name, asked.get(name)).items()}
        looks.pop(name, None)
        current = situation.observed.current(name)
        since = situation.memory.of(name).unproven_since
        if current is not None and since is not None:
            looks[name] = current.id, since
    return Schedule(times=times, targets=targets, looks=looks, asked=asked, engaged=engaged)


def times_of(situation: Situation, name: str, planned: Planned) -> tuple[float, ...]:
    """Return when a service is late, ready by delay, or past its bake, and when its waitings may end."""
    plan, progress = planned.plans[name], situation.memory.of(name)
    times = [w.until for w in (*plan.waitings, *plan.notes) if w.until is not None]
    times += [] if plan.alarm is None else [plan.alarm]
    service = situation.with_probes_in_force(name) if name in situation.desired.catalog.services else None
    delay = service.ready.delay if service and service.ready else None
    if delay is not None and progress.running_since is not None and not progress.ready:
        times.append(progress.running_since + delay)
    current = situation.observed.current(name)
    unproven = current is not None and not progress.update.is_proven(current.id)
    if service and (unproven or not progress.ready) and (late_at := is_late_at(progress, service)) is not None:
        times.append(late_at)
    if service and (mended_at := mended_from(progress, service)) is not None:
        times.append(mended_at)
    if service and unproven and (over := bake_ends_at(progress, service)) is not None:
        times.append(float(ceil(over)))  # not urgent, so round up: one pass serves many services
    if service and (end := doubt_ends(progress, service)) is not None:
        times.append(end)
    return tuple(times)


def told_since(progress: Progress, asked: float | None) -> bool:
    """Return whether a readiness probe succeeded since then."""
    return asked is None or (progress.answered is not None and progress.answered >= asked)


def denied_since(progress: Progress, asked: float) -> bool:
    """Return whether a readiness probe failed since then, and none succeeded after it."""
    return progress.denied is not None and progress.denied >= asked and progress.denied > (progress.answered or 0.0)


def targets_of(planned: Planned, name: str, asked: float | None) -> dict[str, Target]:
    """Return what to probe of one service.

    - ready: while a wanted service runs and is not ready; afterwards only if readiness can be lost or someone has begun
      to wait for it;
    - live: once it was ready;
    - interlock: while the plan or pressure may touch it.

    A readiness delay needs no probe.
    """
    situation, targets = planned.situation, dict[str, Target]()
    wanted, progress = name in situation.wanted, situation.memory.of(name)
    if wanted and progress.running_since is not None:
        service, run = situation.with_probes_in_force(name), progress.incarnation
        current = situation.observed.current(name)
        if service.ready and service.ready.delay is None:
            since = asked if progress.answered is not None and not told_since(progress, asked) else None
            since = max((at for at in (since, progress.unproven_since) if at is not None), default=None)
            if not progress.ready or since is not None or service.ready.failures:
                every = max(service.ready.interval, 1.0) if progress.ready and since is None else service.ready.interval
                targets["ready"] = Target(service.ready, run, every, current, since)
        if service.live and progress.was_ready:
            targets["live"] = Target(service.live, run, service.live.interval, current, progress.unproven_since)
    if wanted and (target := _parameters(planned, name)):
        targets[ROLE] = target
    lock = situation.desired.interlocks.get(name) or _left(situation, name)
    if lock and (busy(planned, name) or (wanted and situation.memory.pressure.engaged)):
        targets["interlock"] = Target(lock, "", lock.interval)
    return targets


def _parameters(planned: Planned, name: str) -> Target | None:
    """Return the ROS parameters to set, for a service that waits for them or runs without them."""
    service, waits = planned.situation.desired.catalog.services[name], _waits_for_parameters(planned, name)
    purpose = due(planned.situation, service)
    runs = planned.situation.memory.of(name).running_since is not None
    if service.ros is None or not purpose or not (waits or runs):
        return None
    return Target(
        probe_of(planned.situation, service), purpose, AGAIN, values=service.ros.values, anew=waits, longest=LONGEST
    )


def _waits_for_parameters(planned: Planned, name: str) -> bool:
    return any(waiting.code == PARAMETERS for waiting in planned.plans[name].waitings)


def _left(situation: Situation, name: str) -> Probe | None:
    """Return the interlock on the label of an undeclared service's container."""
    if name in situation.desired.digests:
        return None
    locks = (rules_of(c.rules).interlock for c in situation.observed.of(name) if c.rules)
    return next(filter(None, locks), None)


def interlocks(desired: Desired, observed: Observed) -> dict[str, Probe]:
    """Return the interlocks of all manifests, and those on labels of undeclared containers: they protect the hardware
    even if the manifest is gone."""
    containers = observed.by_service()
    left = {
        name: lock
        for name in observed.undeclared(desired.digests)
        for c in containers[name]
        if c.rules and (lock := rules_of(c.rules).interlock)
    }
    return {**left, **desired.interlocks}
