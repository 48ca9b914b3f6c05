"""Gates: what each step of a service's chain must follow or wait for: needs, devices, images, interlocks, back-off,
conflicts, exclusive resources, ROS parameters, lingering."""

from __future__ import annotations

from collections.abc import Collection

from rorg.core.deferred import held_back, restarts_for_content
from rorg.core.joining import awaited, ended, is_cut_off, joined_to
from rorg.core.operations import ID, Create, Operation, Remove, Rename, Start, Stop
from rorg.core.plan import Part, Reason, Timed, Waiting, prefixed
from rorg.core.room import FREE, Passage, room
from rorg.core.ros_parameters import due
from rorg.core.situation import View
from rorg.core.steps import Step
from rorg.model.catalog import Service
from rorg.model.causes import verb_before
from rorg.model.codes import DEVICE, FAILED, INTERLOCK, PARAMETERS, REMOVAL, ROOM
from rorg.model.joining import ends_with
from rorg.model.units import format_seconds


def gate(view: View, service: Service, step: Step) -> Passage:
    """Return what a step must follow or wait for."""
    found: list[str] = []
    for passage in (_objects, _joined, _resume, _gate):
        after, waiting = passage(view, service, step)
        if waiting:
            return (), waiting
        found += after
    return tuple(found), None


def _objects(view: View, service: Service, step: Step) -> Passage:
    """Networks and volumes must exist before a container that uses them is created or started."""
    uses = view.desired.uses.get(service.name, ()) if isinstance(step.operation, (Create, Start)) else ()
    for subject in uses:
        plan = view.earlier(subject)
        if plan.unready:
            code = next((w.code for w in plan.waitings), "")
            return (), Waiting(service.name, prefixed(f"{subject} ", plan.unready), code=code)
    return tuple(subject for subject in uses if view.has_actions(subject)), None


def _joined(view: View, service: Service, step: Step) -> Passage:
    """A container is removed after those that are joined to it and go as well: Podman refuses any other order, and what
    goes back to a container needs what that is joined to. For the same reason a container without a manifest is also
    stopped after them; all others stop in the order of their needs."""
    operation = step.operation
    stops = isinstance(operation, Stop) and service.name in view.exclusive.undeclared
    if not (stops or isinstance(operation, Remove)):
        return FREE
    users = dict.fromkeys(
        c.service for c in joined_to(view.s.observed.containers, operation.container) if not stops or c.alive
    )
    left = [u for u in users if not view.has_actions(u) and (u in view.s.wanted or u in view.exclusive.undeclared)]
    if left:
        return (), Waiting(service.name, f"{', '.join(left)} is still joined to its container")
    return tuple(u for u in users if view.has_actions(u)), None


def not_removed(name: str, container: str, why: Reason, at: float | None = None) -> Waiting:
    """Return what is shown while the engine does not remove a container. Nothing else waits for that."""
    return Waiting(name, prefixed(f"the engine does not remove its container {container[:ID]}: ", why), at, REMOVAL)


def waits(reason: Reason) -> Reason:
    """Return why a service waits, as words that follow its name."""
    return prefixed(verb_before(reason if isinstance(reason, str) else reason.before), reason)


def _resume(view: View, service: Service, step: Step) -> Passage:
    """A stop that resumes a paused container needs room for the end of its run."""
    if not (isinstance(step.operation, Stop) and step.operation.resumes):
        return FREE
    after, taken = room(view, service)
    if taken:
        why = prefixed("stays paused, because a stop would resume it: ", taken.reason)
        return (), Waiting(service.name, why, code=ROOM)
    return after, None


def _gate(view: View, service: Service, step: Step) -> Passage:
    name, memory = service.name, view.s.memory.of(service.name)
    operation = step.operation
    if isinstance(operation, Create):
        held = held_back(view, service, step.fields)
        if held:
            return (), held
    if operation.begins and name in view.s.unplugged:
        return (), Waiting(name, view.s.unplugged[name], code=DEVICE)
    written = view.s.unsettled.intersection(view.desired.contents.get(name, ())) if isinstance(operation, Start) else ()
    if written:
        # It would read what rorg has not read yet, and be restarted for that under its requester.
        return (), Waiting(name, f"{', '.join(sorted(written))} is being written")
    if waiting := _back_off(view, name, operation):
        return (), waiting
    swap = step.part_of is Part.REPLACE and isinstance(operation, (Stop, Rename))
    locked = view.s.interlocks.get(name, "") if swap or operation.felt else ""
    if locked:
        return (), Waiting(name, f"interlock: {locked}", code=INTERLOCK)
    begins = operation.begins or step.part_of
    if swap and memory.update.held and not _ends_anyway(view, service):
        return (), _rest_of_set(name, memory.update.held)
    limits = view.desired.catalog.policy.pressure
    # Only for wanted services: a change must not keep a shed service from being stopped.
    admitted = name not in view.s.wanted or limits is None or view.s.priorities.get(name, 0) >= limits.admit
    if view.s.measures.closed and begins and not admitted:
        return (), Waiting(name, view.s.measures.closed)
    if isinstance(operation, Create) and service.joins:
        return _join(view, service)
    if operation.begins or ((swap or _reads_again(view, service, step)) and _goes_on(view, name)):
        passage = _start(view, service, step)  # what runs goes on until its replacement can begin
        return _parameters(view, service) if isinstance(operation, Start) and passage == FREE else passage
    if operation.ends and name not in view.s.wanted:
        return _cease(view, service)
    return FREE


def _rest_of_set(name: str, missing: str) -> Waiting:
    """Return what a service waits for while its set lacks the new container of `missing`, which may be its own."""
    if missing == name:
        return Waiting(name, "waits until all services that change together with it have new containers")
    return Waiting(name, f"waits for the new container of {missing}, which changes together with it")


def _back_off(view: View, name: str, operation: Operation) -> Waiting | None:
    """Return what an operation that failed waits for before it is tried again; None if it may be."""
    memory = view.s.memory.of(name)
    tried = memory.attempt(operation)
    if tried is None or not tried.at or view.has_come(tried.at):
        return None
    if isinstance(operation, Remove):
        why = _next_try(tried.error or "no effect", tried.at)
        return not_removed(name, operation.container, why, tried.at)
    # A program that ended has been started without fault.
    failed = "" if memory.exits else f"{operation.verb} {'stalled' if memory.stalled else 'failed'}: "
    return Waiting(name, _next_try(f"{failed}{tried.error or 'no effect'}", tried.at), tried.at, FAILED)


def _next_try(failure: str, at: float) -> Timed:
    """Return a failure and when its operation is tried again. A reader may see it after that time."""
    return Timed(f"{failure}; again in ", at, due=f"{failure}; trying again now")


def _goes_on(view: View, name: str) -> bool:
    """Return whether a service is wanted, and its current run, if there is one, answers. It may go on until another run
    can begin."""
    current = view.current(name)
    hangs = current is not None and current.incarnation == view.s.memory.of(name).hung
    return name in view.s.wanted and not hangs


def _reads_again(view: View, service: Service, step: Step) -> bool:
    """Return whether a step ends a run only so that the next one reads changed files."""
    current = view.current(service.name)
    ends = step.part_of is Part.RESTART and isinstance(step.operation, Stop)
    return ends and current is not None and restarts_for_content(view, service, current)


def _ends_anyway(view: View, service: Service) -> bool:
    """Return whether the current run ends before its set is complete. The service then begins again in its new
    container."""
    current = view.current(service.name)
    if current is None or not current.active or service.name in view.s.restarts:
        return True
    return is_cut_off(view, service, current)


def _join(view: View, service: Service) -> Passage:
    """The containers to join must exist first, because the engine joins by id."""
    after = tuple(need for need in service.joins if view.has_actions(need))
    if after:
        return after, None
    for need in service.joins:
        if not view.of(need):
            reason = view.unready(need) or "has no container to be joined to"
            return (), Waiting(service.name, prefixed(f"{need} ", reason), _ready_at(view, need))
    return (), awaited(view, service)


def _start(view: View, service: Service, step: Step) -> Passage:
    name, after = service.name, []
    begun = step.operation.container if step.operation.begins else ""
    for need in service.needs:
        if view.has_actions(need):
            after.append(need)
        reason = view.unready(need)
        if not reason and need not in after and need in ends_with(service.joins):
            reason = ended(view, service, need, begun)
        if reason:
            return (), Waiting(name, prefixed(f"{need} ", reason), _ready_at(view, need))
    made, waiting = room(view, service)
    return ((), waiting) if waiting else ((*after, *made), None)


def _parameters(view: View, service: Service) -> Passage:
    """ROS parameters must be set before the start. The master is among the needs, so it is ready by now."""
    if not due(view.s, service):
        return FREE
    why = view.s.memory.of(service.name).not_set
    return (), Waiting(service.name, "its ROS parameters are not set" + (f": {why}" if why else ""), code=PARAMETERS)


def _ready_at(view: View, need: str) -> float | None:
    """Return when a needed service becomes ready by its delay alone."""
    ready = view.s.with_probes_in_force(need).ready if need in view.desired.catalog.services else None
    progress = view.s.memory.of(need)
    if ready and ready.delay is not None and progress.running_since is not None:
        return progress.running_since + ready.delay
    return None


def unready(view: View, service: Service, blocked: Reason, planned: Collection[Operation]) -> Reason:
    """Return what View.unready() says about a service after it was planned. `blocked` is why its chain stops, after
    the `planned` operations. A service that runs and goes on is as ready as before, even if a change of it has to
    wait."""
    progress = view.s.memory.of(service.name)
    goes_on = view.active(service.name) and not any(operation.idles for operation in planned)
    if progress.ready and goes_on:
        return ""
    if blocked and not goes_on:
        return waits(blocked)
    if (planned and not blocked) or view.s.completed(service.name):
        return ""
    if progress.running_since is None:
        return f"is not running ({progress.error or 'ended'})"
    ready = view.s.with_probes_in_force(service.name).ready
    if ready is not None and ready.completed:
        return Timed("has not ended (", progress.running_since, ")")
    seconds = None if ready is None else ready.timeout if ready.delay is None else ready.delay
    limit = "" if seconds is None else f" of {format_seconds(seconds)}"
    detail = f": {progress.probe}" if progress.probe else ""
    return Timed("is not ready (", progress.running_since, f"{limit}){detail}")


def _cease(view: View, service: Service) -> Passage:
    name, after = service.name, []
    if not view.active(name) or name not in view.desired.catalog.services:
        return FREE
    for dependant in view.desired.dependants.get(name, ()):
        if view.s.starting(dependant):
            return (), Waiting(name, f"not wanted, but {dependant} needs it and is being started")
        if view.active(dependant):
            if not view.has_actions(dependant):
                return (), Waiting(name, f"not wanted, but {dependant} needs it and is still active")
            after.append(dependant)
    if view.hurry:
        return tuple(after), None
    until = _lingers_until(view, service)
    if until is not None and not view.has_come(until):
        return (), Waiting(name, Timed("lingers for ", until), until)
    return tuple(after), None


def _lingers_until(view: View, service: Service) -> float | None:
    """Return until when an unwanted service lingers; None if it does not."""
    progress, idle = view.s.memory.of(service.name), service.idle
    if not idle.linger and not idle.min_active:
        return None
    until = (view.now if progress.unwanted_since is None else progress.unwanted_since) + idle.linger
    return until if progress.running_since is None else max(until, progress.running_since + idle.min_active)
