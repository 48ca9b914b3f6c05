"""What rorg promises of a robot at rest: nothing was disturbed, asked or changed for a long time."""

from __future__ import annotations

from dataclasses import replace

from bounded.registry import at
from bounded.watch import Watch, closure_of, last_start, namespaces

from rorg.core.admission import over_budget
from rorg.core.decide import decide
from rorg.core.joining import joined_of
from rorg.core.observed import Container
from rorg.core.probes_in_force import fits
from rorg.model.graph import closure, conflicting, overbooked

QUIET = 100.0
"""Seconds before the rest is judged, in which nothing may happen any more."""
ALLOWED = {
    "pause": ("paused", "created", "exited"),
    "deactivate": ("inactive", "paused", "created", "exited"),
    "stop": ("created", "exited"),
    "remove": (),
}
"""Idle action -> states in which an idle container may be."""


def bad(watch: Watch) -> set[str]:
    """Services with a manifest whose containers fail."""
    return {n for n, d in watch.robot.desired.digests.items() if d in watch.robot.faults.bad}


def loops(watch: Watch) -> set[str]:
    """Services of which no container ever ran well, or that read a bad file at each start, and those that need them:
    they are tried again for ever."""
    robot = watch.robot
    there = {one.id for one in robot.engine.objects.values()}
    # Nobody can go back to a container whose network somebody has taken away.
    able = [c for c in robot.engine.list() if {*c.networks.values()} <= there]
    ran = (c for c in able if c.started_at)
    well = {c.service for c in ran if c.digest not in robot.faults.bad and not ended(watch, c)}
    failed = {n for n in robot.desired.digests if robot.memory.of(n).update.failed}
    return closure_of(robot.desired.catalog, ((bad(watch) | failed) - well) | robot.bad_files | unanswered(watch))


def unanswered(watch: Watch) -> set[str]:
    """Services with a bad probe that have no container like the one that was proven with another probe."""
    there: dict[str, set[str]] = {}
    for container in watch.robot.engine.list():
        there.setdefault(container.service, set()).update((container.id, container.digest))
    return {name for name in watch.robot.bad_probes if not there.get(name, set()) & _proven(watch, name)}


def _proven(watch: Watch, name: str) -> set[str]:
    """The container of a service that stayed well last, and its digest."""
    update = watch.robot.memory.of(name).update
    return {update.well, update.last_good.digest if update.last_good else ""} - {""}


def ended(watch: Watch, container: Container) -> bool:
    """Whether a run of it ended on its own while a change of its service is tried: then rorg does not go back to it."""
    step = watch.robot.memory.of(container.service)
    return step.exited == container.incarnation and not step.update.failed


def wanted(watch: Watch) -> set[str]:
    """Wanted services that can run."""
    robot, situation = watch.robot, watch.robot.decision.situation
    return {n for n in situation.wanted if not watch.services[n].meta} - (loops(watch) - robot.active())


def waiting(watch: Watch) -> set[str]:
    """Services that the plan explains."""
    return {w.service for w in watch.robot.decision.plan.waitings}


def all_of(watch: Watch, name: str) -> list[Container]:
    """The containers of a service."""
    return [c for c in watch.robot.engine.list() if c.service == name]


@at("rest")
def it_comes_to_rest(watch: Watch) -> None:
    """Rorg makes no call any more, except for services of which nothing ever ran well, and for the pressure that comes
    and goes with their runs."""
    robot, looping = watch.robot, loops(watch)
    if looping and robot.desired.catalog.policy.pressure is not None:
        return
    late = [call for call in robot.engine.calls if call[0] > robot.now - QUIET and call[2] not in looping]
    assert not late, f"it does not come to rest: {late[:6]}"


@at("rest")
def the_plan_is_empty_twice(watch: Watch) -> None:
    """A robot at rest has nothing to do: two passes without memory of a plan find no action."""
    read = watch.robot.read
    assert not read.memory.in_flight.keys() - loops(watch), f"at rest, and yet under way: {read.memory.in_flight}"
    for _ in range(2):
        found = decide(replace(read, cache=None))
        left = [a for a in found.plan.actions if a.service not in loops(watch)]
        assert not left, f"at rest, and yet: {left}"
        read = replace(read, memory=found.memory)


@at("rest")
def a_bad_change_leaves_what_ran(watch: Watch) -> None:
    """A service with a bad manifest runs as it was before, unless there is nothing to go back to."""
    robot = watch.robot
    for name in (bad(watch) - loops(watch)) & {*robot.decision.situation.wanted}:
        known = all_of(watch, name)
        old = [c for c in known if c.digest not in robot.faults.bad]
        assert not old or name in waiting(watch), f"{name}: nobody is told"
        untried = not any(c.started_at for c in known if c not in old) and name in waiting(watch)
        assert len(known) <= 1 or untried or robot.memory.of(name).update.held, f"{name} keeps {known}"


@at("rest")
def only_the_wanted_run(watch: Watch) -> None:
    """Nothing runs that nobody wants."""
    active = watch.robot.active() & watch.services.keys()
    assert active <= wanted(watch), f"unwanted: {active - wanted(watch)}"


@at("rest")
def all_that_is_asked_for_and_possible_is_ready(watch: Watch) -> None:
    """Every wanted service runs and is ready, except those of which nothing ever ran well, and those that are frozen,
    shed, or wait for one of these. Whatever does not run is explained."""
    robot = watch.robot
    missing = wanted(watch) - robot.active()
    assert missing <= waiting(watch), f"neither served nor explained: {missing - waiting(watch)}"
    if robot.memory.pressure.level:
        return
    # A run that froze before it was ready is late, and stays: what needs it waits.
    frozen = {c.service for c in robot.engine.list() if c.alive and c.incarnation in robot.hung}
    excused = closure_of(robot.desired.catalog, frozen) | loops(watch)
    assert not missing - excused, robot.decision.plan.text()
    unready = {n for n in wanted(watch) - excused if not robot.memory.of(n).ready}
    assert not unready, f"not ready: {unready}\n{robot.decision.plan.text()}"


@at("rest")
def the_idle_are_as_declared(watch: Watch) -> None:
    """An idle service is as its idle policy says, and has gone as far as that says."""
    robot = watch.robot
    for name, state in robot.states().items():
        if name not in watch.services or name in robot.decision.situation.wanted or name in loops(watch):
            continue
        if state == "paused" and rivals(watch, name) & robot.active() and name in waiting(watch):
            continue  # what conflicts with it runs, so it cannot be resumed to end, also if a person paused it
        idle = watch.services[name].idle
        assert state in ALLOWED[idle.action], (name, state)
        further = idle.escalate[1] if idle.escalate else None
        stays = {None: ("inactive", "paused"), "pause": ("paused",)}.get(further, ())
        assert state not in {"inactive", "paused"} - {*stays}, f"{name} went no further"


def rivals(watch: Watch, name: str) -> set[str]:
    """Services that conflict with one."""
    return {n for pair in conflicting(watch.services, watch.services) if name in pair for n in pair} - {name}


@at("rest")
def one_container_of_a_service(watch: Watch) -> None:
    """No service has a second container, except one that can be gone back to, or that the plan explains, or on which a
    call is under way."""
    explained = waiting(watch) | watch.robot.memory.in_flight.keys()
    for name in watch.robot.states().keys() & watch.services.keys():
        known = all_of(watch, name)
        assert len(known) == 1 or name in explained or kept(known), f"two containers of {name}"


def kept(known: list[Container]) -> bool:
    """The second one is what can be gone back to, if the first is ever wanted again and does not come up."""
    if len(known) != 2:
        return False
    return any(not new.active and not old.alive and new.previous == old.id for new, old in (known, known[::-1]))


@at("rest")
def what_is_joined_is_there(watch: Watch) -> None:
    """What runs is joined to containers that run, and not to earlier runs of them, or the plan explains it."""
    robot = watch.robot
    for name in (robot.active() & watch.services.keys()) - loops(watch):
        run = next(c for c in robot.engine.list() if c.service == name and c.active)
        for id in joined_of(run.joined).values():
            other = robot.engine.inspect(id)
            # Its restart may have to wait while admission is closed; the plan says so.
            shared = id in namespaces(watch.services[name], run) and other
            ended = shared and last_start(watch, other.service) > last_start(watch, name)
            whole = other is not None and other.active and not ended
            assert whole or name in waiting(watch), f"{name} is joined to {other or 'nothing'}"


@at("rest")
def runs_follow_those_that_they_count_on(watch: Watch) -> None:
    """What restarts with a need runs since that need began, or later."""
    for name in (watch.robot.active() & watch.services.keys()) - loops(watch) - waiting(watch):
        for need in watch.services[name].restarts_with:
            other = next((c for c in all_of(watch, need) if c.active), None)
            if other and watch.robot.memory.of(name).counted_on.needs.get(need) != other.incarnation:
                later = last_start(watch, need) > last_start(watch, name)
                assert not later, f"{name} runs on though {need} was restarted"


@at("rest")
def what_runs_is_what_is_declared(watch: Watch) -> None:
    """What runs was made from the present manifest, or the plan says why not."""
    desired = watch.robot.desired
    for name in (watch.robot.active() & watch.services.keys()) - loops(watch) - waiting(watch):
        run = next(c for c in all_of(watch, name) if c.active)
        assert fits(run, name, desired) or watch.robot.memory.of(name).update.failed, f"{name} runs as it was before"


@at("rest")
def the_hung_are_restarted(watch: Watch) -> None:
    """A run that was ready and does not answer any more has ended."""
    for container in watch.robot.engine.list():
        step = watch.robot.memory.of(container.service)
        if container.alive and container.incarnation in watch.robot.hung and container.service in wanted(watch):
            live = watch.services[container.service].live
            assert not (live and step.was_ready), f"{container.service} hangs"


@at("rest")
def nobody_waits_in_vain(watch: Watch) -> None:
    """What gave way could not run beside what runs."""
    robot, catalog = watch.robot, watch.robot.desired.catalog
    situation, services, budget = robot.decision.situation, catalog.services, catalog.policy.budget
    out = {*robot.decision.holds, *(s.service for s in robot.memory.pressure.shed)}
    for name in situation.preempted:
        more = {n for n in closure(services, [name]) if not services[n].meta}
        names = {*situation.wanted, *more}
        in_the_way = more & out or overbooked(catalog, names) or conflicting(services, names)
        # A request is queued whole: what it asks for besides may be too much.
        asked = [closure(services, r.services) for r in robot.decision.settled.requests]
        too_much = (
            budget
            and budget.over == "queue"
            and any(over_budget(catalog, {*situation.wanted, *request}) for request in asked if name in request)
        )
        assert in_the_way or too_much, f"{name} waits for nothing: {situation.preempted[name]}"


@at("rest")
def networks_go_with_their_users(watch: Watch) -> None:
    """Rorg keeps no network that no manifest declares and no container uses."""
    engine, declared = watch.robot.engine, watch.robot.desired.objects.values()
    used = {f"network/{n}" for c in engine.list() for n in c.networks}
    ours = {key for key, one in engine.objects.items() if one.owner and one.kind == "network"}
    assert ours <= used | {one.key for one in declared}, "a network that nobody declares or uses goes"


@at("rest")
def strangers_are_as_they_were(watch: Watch) -> None:
    """Containers that do not belong to rorg are still there, untouched."""
    engine = watch.robot.engine
    for id in engine.strangers:
        assert id in engine.containers, "a stranger is gone"
        assert engine.containers[id].state == "running", "a stranger was ended"
