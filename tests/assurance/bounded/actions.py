"""What rorg promises of each action: when it begins, and when the engine executes its call."""

from __future__ import annotations

from collections.abc import Collection

from bounded.registry import at
from bounded.watch import EXACT, Watch, known, namespaces

from rorg.core.joining import joined_of
from rorg.core.observed import LABEL_SPEC
from rorg.core.operations import Stop
from rorg.core.plan import Action
from rorg.core.probes_in_force import fits
from rorg.model.graph import conflicting

# -- when an action begins -----------------------------------------------------------------------------------------


@at("begin")
def nothing_begins_while_it_must_not(watch: Watch) -> None:
    """Nothing begins while rorg is suspended, does not see the engine, or against an interlock."""
    name, action = watch.action
    situation = watch.robot.decision.situation
    assert not situation.suspended, f"{action} while suspended"
    assert situation.observed.complete, f"{action} on an incomplete observation"
    assert name not in watch.robot.locked or action.verb in ("create", "rename"), f"{action} against its interlock"
    assert action.verb not in ("start", "resume") or name not in watch.robot.decision.holds, f"{action} while held"


@at("begin")
def needs_are_ready_first(watch: Watch) -> None:
    """Nothing starts or resumes before all that it needs is ready."""
    name, action = watch.action
    for need in watch.services[name].needs if action.verb in ("start", "resume") else ():
        ready = watch.services[need].meta or watch.robot.memory.of(need).ready
        assert ready, f"{name} was begun before {need} was ready"


@at("begin")
def only_the_wanted_begin(watch: Watch) -> None:
    """Only a wanted service starts or resumes."""
    name, action = watch.action
    assert action.verb not in ("start", "resume") or name in watch.robot.decision.situation.wanted, f"{action}"


@at("begin")
def nothing_begins_against_rivals(watch: Watch) -> None:
    """Nothing starts while a run that conflicts with it, or that has its exclusive resource, goes on or is being
    started."""
    name, action = watch.action
    if action.verb in ("start", "resume") or name in watch.resumed():
        flights = watch.robot.memory.in_flight.items()
        alone(watch, name, {n for n, flight in flights if flight.action.verb in ("start", "resume")})


def alone(watch: Watch, name: str, begun: Collection[str] = ()) -> None:
    """Nothing that is alive by the engine, that is being `begun`, or that is resumed to end, stands against its run."""
    begun = {*begun, *watch.resumed()}
    catalog, others = watch.robot.desired.catalog, {*watch.alive(but=name), *begun} - {name}
    for resource, units in catalog.services[name].exclusive.items():
        used = sum(catalog.services[n].exclusive.get(resource, 0) for n in others)
        assert used + units <= catalog.policy.resources.get(resource, 1), f"more {resource} than there is"
    active = {n for n in {*watch.robot.active(), *begun} if n in catalog.services}
    assert not [p for p in conflicting(catalog.services, {*active, name}) if name in p], f"{name} conflicts"


@at("begin")
def nothing_begins_beside_itself(watch: Watch) -> None:
    """Nothing starts beside another run of it, or joined to a container that does not run."""
    name, action = watch.action
    if action.verb not in ("start", "resume"):
        return
    situation = watch.robot.decision.situation
    for id in namespaces(watch.services[name], known(situation, action.container)):
        other = known(situation, id)
        assert other, f"{action}, joined to nothing"
        assert other.alive, f"{action}, joined to {other}"
    containers = watch.robot.engine.list()
    others = [c for c in containers if c.service == name and c.active and c.id != action.container]
    assert not others, f"{action} beside {others}"


@at("begin")
def a_set_changes_together(watch: Watch) -> None:
    """One that goes together with others makes way for its new container once those of all are there."""
    name, action = watch.action
    if action.verb == "stop":
        together(watch, name, action)


def together(watch: Watch, name: str, action: Action) -> None:
    """Check a stop of one that changes together with others."""
    robot, desired = watch.robot, watch.robot.desired
    wanted, found = robot.decision.situation.wanted, {c.id: c for c in robot.engine.list()}
    stopped = found.get(action.container)  # a hand may have removed it
    if action.reason != "changed" or name not in wanted or stopped is None or not stopped.active:
        return
    if name in robot.decision.situation.restarts:
        return
    run = found[action.container]
    if fits(run, name, desired):
        return  # another node of its device, or another network, is no change of its manifest
    joined, shared = joined_of(run.joined).values(), namespaces(desired.catalog.services[name], run)
    if any(id not in found or (id in shared and not found[id].alive) for id in joined):
        return  # what it is joined to is gone or over: it cannot go on as it is, nor be gone back to
    if name in robot.bad_probes and stopped.id not in watch.good:
        return  # it ends again and again as it is, and is changed alone
    members = {*desired.sets.get(desired.catalog.services[name].update.atomic, ())}
    if run.previous in found and any(robot.memory.of(m).update.failed for m in members):
        return  # the change of one has failed, and the others go back too
    for other in members & {*wanted}:
        own = [c for c in found.values() if c.service == other]
        assert not own or any(fits(c, other, desired) for c in own), f"{name} was ended before {other} was made"


@at("begin")
def a_restart_has_its_cause(watch: Watch) -> None:
    """A run ends because a need was restarted only if that need was started again since this run began."""
    name, action = watch.action
    if action.reason.endswith(" was restarted"):
        # Since the call that started it began: by a later time of the engine it may have begun before that.
        need = action.reason.split()[0]
        since = [at for at, verb, other in watch.robot.engine.calls if (verb, other) == ("start", need)]
        assert len(since) > 1, f"{need} was not restarted"
        # By hand at that moment, too, or shortly before, which rorg could not see.
        late = since[-1] >= watch.starts.get(name, -1.0) or need in watch.unseen.get(name, ())
        assert late, f"{need} was not restarted"


@at("begin")
def no_new_probe_ends_what_was_proven(watch: Watch) -> None:
    """A container that was proven ends for its `live` probe only if its program does not answer any more."""
    name, action = watch.action
    step = watch.robot.memory.of(name)
    if isinstance(action.operation, Stop) and action.operation.incarnation == step.hung and step.hung:
        proven = action.operation.container == step.update.well and step.update.baked != step.update.edition
        runs = any(c.incarnation == step.hung and c.state == "running" for c in watch.robot.engine.list())
        assert not (proven and runs) or step.hung in watch.robot.hung, f"{name} answers what it was proven with"


@at("begin")
def the_same_is_not_created_again(watch: Watch) -> None:
    """A service gets no new container while one with the same digest exists and can be used. One that ended cannot
    while another stayed well last, to which it has no way back. Nor can one that never ran, and whose way
    back leads past what was proven since."""
    name, action = watch.action
    service = watch.services.get(name)
    if action.verb != "create" or service is None or service.joins or service.devices or watch.robot.desired.objects:
        return
    digest, step = action.operation.labels[LABEL_SPEC], watch.robot.memory.of(name)
    usable = [c for c in watch.robot.read.observed.of(name) if c.state not in ("dead", "removing")]
    same, well = [c for c in usable if c.digest == digest and not step.spent(c)], step.update.well
    past = {c.previous for c in usable if c.id == step.update.proven} - {""}
    same = [c for c in same if c.started_at or c.previous not in past]
    if well in {c.id for c in usable}:
        same = [c for c in same if c.alive or not c.started_at or well in (c.id, c.previous)]
    assert not same, f"{name} has a container of this digest"


@at("begin")
def the_good_stay_until_the_next_is_proven(watch: Watch) -> None:
    """A container that stayed well is removed, while its service is wanted, only if its successor stayed well. A set
    goes back together, also to what had not run for long."""
    name, action = watch.action
    situation = watch.robot.decision.situation
    if action.verb != "remove" or action.container not in watch.good or name not in situation.wanted:
        return
    service = watch.services[name]
    if service.joins or service.devices or watch.robot.desired.objects:
        return
    rest = [c for c in situation.observed.of(name) if c.id != action.container]
    proven, drawn = watch.robot.memory.of(name).update.proven, watch.robot.memory.of(name).update.drawn
    assert drawn or any(c.id in watch.well or c.id == proven for c in rest), f"{name} has nothing to go back to"


@at("begin")
def dependants_end_first(watch: Watch) -> None:
    """A service that runs and that nobody wants ends after all that need it. One that a person paused serves nobody."""
    name, action = watch.action
    situation, desired = watch.robot.decision.situation, watch.robot.desired
    if not any(c.active for c in situation.observed.of(name)):
        return
    if action.verb not in ("stop", "pause", "deactivate") or name in situation.wanted or name not in watch.services:
        return
    active = [n for n in desired.dependants[name] if any(c.active for c in situation.observed.of(n))]
    assert not active, f"{action} before {active}"


@at("begin")
def the_idle_linger(watch: Watch) -> None:
    """A service that is no longer wanted runs on for its `linger`, unless something else wants its place."""
    name, action = watch.action
    situation, service = watch.robot.decision.situation, watch.services.get(name)
    if action.verb not in ("stop", "pause") or service is None or name not in watch.unwanted:
        return
    rivals = service.exclusive or watch.robot.desired.conflicts[name] or name in situation.preempted
    pressed = watch.robot.memory.pressure.engaged or name in situation.unplugged or name in situation.excluded
    moved = any(c.id == action.container and c.joined for c in situation.observed.of(name)) or service.needs
    running = any(c.active for c in situation.observed.of(name)[:1])
    if not (rivals or pressed or moved or not running or action.part_of or action.surplus):
        lingered = watch.robot.now - watch.unwanted[name]
        assert lingered >= service.idle.linger - EXACT, f"{name} lingered for {lingered} s"


@at("begin")
def what_failed_is_not_tried_again(watch: Watch) -> None:
    """An edition that failed is not tried again while there is a container to go back to."""
    name, action = watch.action
    edition = watch.robot.memory.of(name).update.edition
    if action.verb == "create" and (name, edition) in watch.quarantined:
        own = watch.robot.read.observed.of(name)
        digest = watch.robot.desired.digests[name]
        back = [c for c in own if c.started_at and c.digest != digest and c.state not in ("dead", "removing")]
        assert not back or watch.services[name].joins, f"{name} tries {edition} again"


# -- when the engine executes a call -------------------------------------------------------------------------------


@at("call")
def rivals_never_run_together(watch: Watch) -> None:
    """By the engine's own events: a start or resume never meets a run that conflicts, or has its exclusive resource. A
    paused run that is stopped is resumed."""
    verb, _, service = watch.call
    if (verb in ("start", "resume") or service in watch.resumed()) and service in watch.services:
        alone(watch, service)


@at("call")
def only_what_is_ours_is_touched(watch: Watch) -> None:
    """Rorg calls the engine only about containers with its label that name a service, and about its own objects."""
    verb, container, service = watch.call
    assert service, f"{verb} of a container that belongs to nobody"
    assert container is None or container.id not in watch.robot.engine.strangers, f"{verb} of a stranger"
