"""When to look again though nothing wakes the loop, and what to probe meanwhile."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from math import ceil
from typing import Any

from rorg.core.desired import Desired
from rorg.core.digest import rules_of
from rorg.core.memory import Progress
from rorg.core.observed import Container, Observed
from rorg.core.onward import Planned, busy
from rorg.core.rollout import bake_ends_at, is_late_at
from rorg.core.ros_parameters import AGAIN, LONGEST, ROLE, due, probe_of
from rorg.core.situation import Situation
from rorg.core.transitions import doubt_ends
from rorg.model.catalog import Probe
from rorg.model.codes import PARAMETERS


@dataclass(frozen=True, slots=True)
class Target:
    """Something to probe, as long as it is told to. Two equal ones ask the same."""

    probe: Probe
    incarnation: str
    every: float
    container: Container | None = field(default=None, compare=False)
    asked: float | None = field(default=None, compare=False)
    """Somebody, or a verdict, waits for an answer that was asked for since then."""
    values: Mapping[str, Any] = field(default_factory=dict, compare=False)
    """Of ROS parameters; which ones these are, the probe tells too."""
    anew: bool = False
    """They are to be set whatever the master has."""
    longest: float = 0.0
    """Seconds up to which the time between attempts doubles while they fail; 0 where it does not."""

    def next_after(self, failures: int) -> float:
        """Seconds from one attempt to the next, after so many failures in a row."""
        doubled = self.every * 2.0 ** min(max(failures - 1, 0), 10)
        return min(doubled, max(self.every, self.longest))

    part: int = 0
    """Which of the probe's questions it is."""

    def parts(self) -> tuple[Target, ...]:
        """Its questions, one by one, each as often as itself says and this one allows."""
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
    """`asked`: service -> since when somebody waits for it."""

    times: Mapping[str, tuple[float, ...]]
    """Service -> times at which something may be due, by the loop's clock."""
    targets: Targets
    looks: Mapping[str, tuple[str, float]]
    """Service -> the container of which a verdict waits for a look that begins after that moment."""
    asked: Mapping[str, float]
    engaged: bool
    """Measures against pressure were in force, or what was shed."""

    def next(self, now: float) -> float | None:
        return min((at for times in self.times.values() for at in times if at > now), default=None)


def schedule(kept: Schedule | None, planned: Planned, asked: Mapping[str, float]) -> Schedule:
    """Of all services, or of those that were planned in this pass, the others as they were."""
    situation = planned.situation
    engaged = situation.memory.pressure.engaged
    names: Collection[str] = planned.looked_at
    if kept is None or planned.whole or kept.engaged != engaged:
        times, targets, looks, names = {}, {}, {}, planned.names
    else:
        times, targets, looks = {**kept.times}, {**kept.targets}, {**kept.looks}
        names = {
            *names,
            *(n for n in {*asked, *kept.asked} if asked.get(n) != kept.asked.get(n) and n in planned.places),
        }
    for name in names:
        found = times_of(situation, name, planned)
        if found:
            times[name] = found
        else:
            times.pop(name, None)
        for role in ("ready", "live", "interlock", ROLE):
            targets.pop((name, role), None)
        targets |= {(name, role): target for role, target in targets_of(planned, name, asked.get(name)).items()}
        looks.pop(name, None)
        current = next(iter(situation.observed.by_service().get(name, ())), None)
        since = situation.memory.of(name).unproven_since
        if current is not None and since is not None:
            looks[name] = current.id, since
    return Schedule(times=times, targets=targets, looks=looks, asked=asked, engaged=engaged)


def times_of(situation: Situation, name: str, planned: Planned) -> tuple[float, ...]:
    """When a service is late, ready by the clock, or well for its bake; when what it waits for may be over."""
    plan, step = planned.plans[name], situation.memory.of(name)
    times = [w.until for w in (*plan.waitings, *plan.notes) if w.until is not None]
    times += [] if plan.alarm is None else [plan.alarm]
    service = situation.desired.catalog.services.get(name)
    delay = service.ready.delay if service and service.ready else None
    if delay is not None and step.running_since is not None and not step.ready:
        times.append(step.running_since + delay)
    unproven = step.update.baked != step.update.edition
    if service and (unproven or not step.ready) and (late_at := is_late_at(step, service)) is not None:
        times.append(late_at)
    if service and unproven and (over := bake_ends_at(step, service)) is not None:
        times.append(float(ceil(over)))  # nobody waits for it: one pass for many
    if service and (end := doubt_ends(step, service)) is not None:
        times.append(end)
    return tuple(times)


def told_since(step: Progress, asked: float | None) -> bool:
    """Whether a readiness probe has said yes since somebody asked."""
    return asked is None or (step.answered is not None and step.answered >= asked)


def denied_since(step: Progress, asked: float) -> bool:
    """Whether a readiness probe has said no since somebody asked, and none has said yes since then."""
    return step.denied is not None and step.denied >= asked and step.denied > (step.answered or 0.0)


def targets_of(planned: Planned, name: str, asked: float | None) -> dict[str, Target]:
    """Readiness of a wanted service that runs, until it is ready (or always, where it can be lost, and once more for
    whoever begins to wait for it); life of one that is; the interlock of one that the plan wants to touch, or that
    measures against pressure may. A probe that is the clock needs nobody to ask."""
    situation, found = planned.situation, dict[str, Target]()
    wanted, step = name in situation.wanted, situation.memory.of(name)
    if wanted and step.running_since is not None:
        service, run = situation.desired.catalog.services[name], step.incarnation
        current = next(iter(situation.observed.by_service().get(name, ())), None)
        if service.ready and service.ready.delay is None:
            since = asked if step.answered is not None and not told_since(step, asked) else None
            since = max((at for at in (since, step.unproven_since) if at is not None), default=None)
            if not step.ready or since is not None or service.ready.failures:
                every = max(service.ready.interval, 1.0) if step.ready and since is None else service.ready.interval
                found["ready"] = Target(service.ready, run, every, current, since)
        if service.live and step.was_ready:
            found["live"] = Target(service.live, run, service.live.interval, current, step.unproven_since)
    if wanted and (target := _parameters(planned, name)):
        found[ROLE] = target
    lock = situation.desired.interlocks.get(name) or _left(situation, name)
    if lock and (busy(planned, name) or (wanted and situation.memory.pressure.engaged)):
        found["interlock"] = Target(lock, "", lock.interval)
    return found


def _parameters(planned: Planned, name: str) -> Target | None:
    """ROS parameters of a service that waits for them, or that runs without."""
    service, waits = planned.situation.desired.catalog.services[name], _waits_for_parameters(planned, name)
    found = due(planned.situation, service)
    runs = planned.situation.memory.of(name).running_since is not None
    if service.ros is None or not found or not (waits or runs):
        return None
    return Target(
        probe_of(planned.situation, service), found, AGAIN, values=service.ros.values, anew=waits, longest=LONGEST
    )


def _waits_for_parameters(planned: Planned, name: str) -> bool:
    return any(waiting.code == PARAMETERS for waiting in planned.plans[name].waitings)


def _left(situation: Situation, name: str) -> Probe | None:
    """The interlock that the last container of a service that no manifest declares any more was made with."""
    if name in situation.desired.digests:
        return None
    locks = (rules_of(c.rules).interlock for c in situation.observed.by_service().get(name, ()) if c.rules)
    return next(filter(None, locks), None)


def interlocks(desired: Desired, observed: Observed) -> dict[str, Probe]:
    """Those of the manifests; and of containers that no manifest declares any more, those that they were made with."""
    there = observed.by_service()
    left = {
        name: lock
        for name in there.keys() - desired.digests.keys()
        for c in there[name]
        if c.rules and (lock := rules_of(c.rules).interlock)
    }
    return {**left, **desired.interlocks}
