"""The promises that rorg keeps in every pass and with every call, each as one small function.

INVARIANTS holds all of them by name. Properties, bounded worlds and planted defects check the same ones: those of the
moment `pass` after each pass (here), of `begin` when rorg begins an action and of `call` when the engine executes a
call of rorg's (actions.py), and of `rest` when nothing has happened for a long time (resting.py).
"""

from __future__ import annotations

import json
from dataclasses import replace

from bounded import actions, recorded, resting
from bounded.registry import INVARIANTS, Invariant, Violation, at, check
from bounded.watch import EXACT, Watch, last_start, lease_of

from rorg.core.admission import Admitted
from rorg.core.decide import Decision, decide
from rorg.core.inputs import Inputs
from rorg.core.pressure import excess, helps
from rorg.core.priorities import PROTECTED
from rorg.daemon.snapshot import snapshot
from rorg.model.graph import closure, conflicting, overbooked

__all__ = ["INVARIANTS", "Invariant", "Violation", "Watch", "actions", "at", "check", "recorded", "resting"]

# -- after each pass -----------------------------------------------------------------------------------------------


@at("pass")
def a_kept_pass_decides_as_a_fresh_one(watch: Watch) -> None:
    """What rorg keeps from one pass for the next changes no decision."""
    if watch.eventful:
        same_as_anew(watch.robot.read, watch.robot.decision)


def same_as_anew(read: Inputs, found: Decision) -> None:
    """What is kept from one pass for the next one changes nothing but the time that it takes."""
    anew = decide(replace(read, cache=None, memory=replace(read.memory, admitted=Admitted())))
    assert found.plan == anew.plan, f"{found.plan.text()}\nanew:\n{anew.plan.text()}"
    assert found.planned.plans == anew.planned.plans
    assert found.begin == anew.begin
    assert found.memory == replace(anew.memory, admitted=found.memory.admitted)
    assert dict(found.to_probe) == dict(anew.to_probe)
    assert found.deadline == anew.deadline
    assert found.violations == anew.violations


@at("pass")
def the_status_says_what_was_decided(watch: Watch) -> None:
    """The status that rorg updates in place says the same as one that is written from nothing."""
    watch.snapshots.note(watch.robot.decision)
    if watch.passes % 3 == 0 and watch.eventful:
        text = watch.snapshots.text({"pid": 1})
        assert json.loads(text) == json.loads(json.dumps(snapshot(watch.robot.decision, {"pid": 1})))


@at("pass")
def a_bake_ends_with_evidence(watch: Watch) -> None:
    """An edition has stayed well only if rorg looked at the container, and its probes answered, after the bake
    ended."""
    read, robot = watch.robot.read, watch.robot
    for name, step in robot.memory.progress.items():
        service = watch.services.get(name)
        if step.update.baked in ("", watch.baked.get(name)) or step.well_since is None or service is None:
            continue
        run = read.observed.by_service()[name][0]
        over = step.well_since + service.update.bake
        asked = [r for r, p in (("ready", service.ready), ("live", service.live)) if p and p.delay is None]
        assert robot.now >= over, f"{name} has not been well for its bake"
        assert read.observed.looked[run.id] >= over, f"nobody has looked at {name}"
        assert all((said := read.results[name, r]).ok and said.at >= over for r in asked), f"{name} was not asked"


@at("pass")
def nothing_fails_that_was_not_tried(watch: Watch) -> None:
    """A change fails only after its container has run, or the engine has refused to start it."""
    robot = watch.robot
    for name, step in robot.memory.progress.items():
        service, digest = watch.services.get(name), robot.desired.digests.get(name)
        if (
            service is None
            or service.joins
            or robot.desired.objects
            or step.update.edition not in step.update.quarantined
        ):
            continue
        made = [c for c in robot.read.observed.of(name) if c.digest == digest]
        tried = digest in watch.tried or digest in robot.faults.bad or digest in robot.refused
        assert tried or not made, f"{name} failed without having run: {step.update.failed}"


@at("pass")
def the_wanted_run_or_are_explained(watch: Watch) -> None:
    """Each wanted service runs, or the plan says why not."""
    situation, states = watch.robot.decision.situation, watch.robot.states()
    for name in situation.wanted if situation.observed.complete else ():
        running = states.get(name) == "running" or watch.robot.lags(name)
        assert watch.services[name].meta or running or name in watch.told, f"{name}: not explained"


@at("pass")
def the_unwanted_end_or_are_explained(watch: Watch) -> None:
    """Each service that runs is wanted, or the plan says why it still runs."""
    situation = watch.robot.decision.situation
    for name in watch.robot.active() - {""} if situation.observed.complete else ():
        known = name in situation.wanted or name in watch.told or watch.robot.lags(name)
        assert known, f"{name} runs though nobody wants it"


@at("pass")
def no_request_outlives_its_requester(watch: Watch) -> None:
    """A service's request lasts only as long as the run that sent it."""
    decision = watch.robot.decision
    alive = {c.incarnation for c in watch.robot.read.observed.containers if c.alive}
    late = [r for r in decision.settled.requests if r.requester != "developer" and r.incarnation not in alive]
    assert not (late and decision.situation.observed.complete), f"{late[0].requester} ended, and its request goes on"


@at("pass")
def no_request_is_lost_or_doubled(watch: Watch) -> None:
    """A request that rorg acknowledged stays, once, until it is released, its lease ends or its requester's run
    ends."""
    read, settled = watch.robot.read, watch.robot.decision.settled
    keys, before = [r.key for r in settled.requests], [r.key for r in read.requests]
    dropped = {r.key: r for r, _ in settled.dropped}
    acked = watch.robot.acknowledged
    assert acked is None or {*before} == acked, f"lost or kept: {acked ^ {*before}}"
    assert len(keys) == len({*keys}), "a request is doubled"
    assert {*keys} | {*dropped} == {*before}, f"lost: {({*before} - {*keys}) - {*dropped}}"
    assert [k for k in before if k not in dropped] == keys, "requests change their order"
    alive = {c.incarnation for c in read.observed.containers if c.alive}
    for request in dropped.values():
        over = request.requester != "developer" and request.incarnation not in alive
        since = watch.leased.get(lease_of(request, read.renewals), read.now)
        ran_out = request.ttl is not None and read.now >= since + request.ttl - EXACT
        assert over or ran_out, f"{request.id} is dropped though it is live"


@at("pass")
def the_wanted_follow_the_rule(watch: Watch) -> None:
    """Wanted is the least set with every meta-service, every service that is always on, all that live requests of its
    members name, and all that its members need; less what gives way."""
    situation, catalog = watch.robot.decision.situation, watch.robot.desired.catalog
    requests = (*catalog.requests, *watch.robot.decision.settled.requests)
    rule, pending = set[str](), [n for n, s in watch.services.items() if s.meta or s.always_on]
    while pending:
        name = pending.pop()
        if name in rule or name in situation.preempted or name in situation.excluded or name not in watch.services:
            continue
        rule.add(name)
        pending += watch.services[name].needs
        pending += [m for r in requests if r.requester == name for s in r.services for m in catalog.members(s)]
    if not watch.robot.memory.pressure.shed and not situation.withheld:
        assert situation.wanted.keys() == rule, f"wanted: {sorted(situation.wanted)}, by the rule: {sorted(rule)}"


@at("pass")
def only_rivals_that_fit_are_wanted(watch: Watch) -> None:
    """No two services that conflict are wanted, nor more of an exclusive resource than there is."""
    wanted, catalog = watch.robot.decision.situation.wanted, watch.robot.desired.catalog
    assert not conflicting(catalog.services, wanted), "rivals are wanted"
    assert not overbooked(catalog, wanted), "more is wanted than there is"


@at("pass")
def a_stop_is_no_crash(watch: Watch) -> None:
    """Rorg counts no run that it stopped itself as one that failed."""
    # Plain sim engines give all containers the same first digits, by which rorg tells runs apart.
    real = len({c[:12] for c in watch.robot.engine.containers}) == len(watch.robot.engine.containers)
    for name, step in watch.robot.memory.progress.items() if real and watch.robot.acknowledged is not None else ():
        assert step.exited not in watch.stopped, f"{name} was stopped, and counts as ended by itself"


@at("pass")
def leases_run_out(watch: Watch) -> None:
    """A request whose lease was not renewed for its whole time is dropped."""
    read, asleep = watch.robot.read, {c.service for c in watch.robot.read.observed.containers if c.asleep}
    for request in watch.robot.decision.settled.requests if read.observed.complete else ():
        if request.ttl is not None and request.requester not in asleep:
            lease = watch.robot.memory.leases.get(request.key)
            until = lease.until if lease else read.now
            most = watch.leased.get(lease_of(request, read.renewals), read.now) + request.ttl
            assert read.now < until <= most + EXACT, f"{request.id} lasts longer than its lease"


@at("pass")
def ready_means_ready(watch: Watch) -> None:
    """Rorg calls a service ready only if its container runs, and its probe answered or its delay passed in this very
    run."""
    robot, read = watch.robot, watch.robot.read
    for name, step in robot.memory.progress.items() if read.observed.complete else ():
        service, current = watch.services.get(name), read.observed.current(name)
        if not step.ready or service is None or service.meta:
            continue
        assert current, f"{name} is called ready without a container"
        assert (current.state, current.incarnation) == ("running", step.incarnation), f"{name} is {current.state}"
        if watch.ready.get(name) == step.incarnation:
            continue
        if robot.lags(name):
            continue  # a person may have restarted it since
        if service.ready and service.ready.delay is not None:
            ran = robot.now - last_start(watch, name)
            assert ran >= service.ready.delay - 0.01, f"{name} is called ready after {ran} s"
        elif service.ready:
            said = read.results.get((name, "ready"))
            assert said is not None, f"{name} was not asked"
            assert said.ok, f"{name} did not answer"
            assert (said.incarnation, said.at >= step.running_since) == (step.incarnation, True), f"{name}: too old"


@at("pass")
def one_run_of_a_service(watch: Watch) -> None:
    """No service has two containers that are active at the same time."""
    active = [c.service for c in watch.robot.engine.containers.values() if c.active and c.service in watch.services]
    assert len(active) == len({*active}), f"two run: {active}"


@at("pass")
def the_least_important_is_shed(watch: Watch) -> None:
    """What was shed just now mattered least of all whose end would help, and no more important request held it."""
    policy, load = watch.robot.desired.catalog.policy, watch.robot.read.load
    over = excess(policy.pressure, policy.budget, load) if policy.pressure and load else {}
    situation, services = watch.robot.decision.situation, watch.services
    before = {s.service for s in watch.shed_before}
    for shed in (s.service for s in watch.shed if s not in watch.shed_before or s.service not in before):
        assert not situation.suspended
        assert not services[shed].protected
        for name in situation.wanted:
            assert shed not in services[name].needs, f"{name} needs {shed}"
        askers = {r.requester for r in watch.robot.decision.settled.requests}
        # What was shed comes back: what it needs does not go in its place.
        needed = {n for w in (*situation.wanted, *(s.service for s in watch.shed)) for n in services[w].needs}
        shields = {n for n in situation.wanted if any(services[m].protected for m in closure(services, [n]))}
        spared = {*askers, *needed, *shields, *closure(services, [shed])}
        others = [
            n
            for n, rank in situation.priorities.items()
            if rank < PROTECTED
            and not services[n].meta
            and n in watch.robot.active()
            and n not in spared
            and not services[n].interlock
            and helps(over, *load.use.get(n, (0.0, 0)))
        ]
        ranks = {n: max(situation.priorities[n], watch.ranks.get(n, 0)) for n in others}
        assert all(rank >= services[shed].priority for rank in ranks.values()), (shed, ranks)
