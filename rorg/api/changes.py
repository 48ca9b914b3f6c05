"""Every operation that changes what is asked of a robot: what it does to the requests file, and the event that reports
it. Pure functions without I/O or clock, because both a running loop and a command without one use them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, NamedTuple

from pydantic import Field

from rorg.api.current import Current
from rorg.api.inputs import Body, Force, ServiceName, Short, seconds_of
from rorg.core.affected import Affected, by_hold, by_release, by_restart
from rorg.core.holds import Moment, begin_hold, seconds_left
from rorg.core.requests import MOST_TOLD, Problem, mistakes, problems
from rorg.errors import Invalid, Refused, Unconfirmed
from rorg.model.catalog import Request
from rorg.model.health import Health
from rorg.model.units import format_seconds, stamp
from rorg.store.requests_document import RequestsDocument
from rorg.store.requests_limits import no_room


@dataclass(frozen=True, slots=True)
class Change:
    """A permitted operation. `edit` is applied to the requests file as it is by then, and may still refuse."""

    edit: Callable[[RequestsDocument], RequestsDocument]
    kind: str
    """Of its event: a stable word."""
    message: str
    """Of its event, for people."""
    services: tuple[str, ...] = ()
    """The services that it is about."""
    about: Mapping[str, Any] = field(default_factory=dict)
    """More fields of its event."""


def put_request(current: Current, request: Request) -> Change:
    """Makes a request, bound to the current run of its requester, in place of the one with the same requester and id.
    It is accepted whole or refused whole. Raises Busy or Refused if its requester is not known to run,
    Refused if no manifests are in force, and Invalid for mistakes; the edit raises Refused for what conflicts with
    other requests, or is too much."""
    catalog = current.catalog
    current.check_in_force(f"request {', '.join(request.services[:MOST_TOLD])}")
    request = replace(request, incarnation=current.incarnation(request.requester))
    _refuse(request, mistakes(catalog, request))

    def edit(document: RequestsDocument) -> RequestsDocument:
        if document.down:
            raise Refused(f"request {', '.join(request.services[:MOST_TOLD])}", "the robot is down", "`rorg up`")
        _refuse(request, problems(catalog, document.requests, request))
        full = no_room(document, request)
        if full:
            raise Refused(f"accept another request of {request.requester}", full, "to release some, or name groups")
        return document.put(request)

    told = f"request '{request.id}' of {request.requester}: {', '.join(request.services)}"
    about = {"service": request.requester, "request": request.id, "requested": list(request.services)}
    about |= {"reason": request.reason} if request.reason else {}
    return Change(edit, "request", told, request.services, about)


def _refuse(request: Request, obstacles: Sequence[Problem]) -> None:
    """Raises an error that names the problems, if there are any."""
    if obstacles:
        kind = Invalid if obstacles[0].mistaken else Refused
        names = ", ".join(request.services[:MOST_TOLD])
        raise kind(f"request {names}", "; ".join(p.cause for p in obstacles), obstacles[0].remedy)


def release(key: tuple[str, str], current: Current | None = None) -> Change:
    """Ends the request of a (requester, id); releasing twice is fine. With `current`, raises Unconfirmed if that stops
    a driver that the request names, or takes something from a service that asked for it itself."""
    requester, id = key
    if current is not None:
        _ask(f"release '{id}'", by_release(current.decision.situation, current.decision.memory, key))
    told = f"request '{id}' of {requester} released"
    return Change(
        lambda document: document.without({key}), "release", told, about={"service": requester, "request": id}
    )


def restart(current: Current, name: str, force: bool, now: float) -> Change:
    """Asks for a restart of a service, or of each of a group, at `now`, in seconds since the epoch. Raises Missing;
    Invalid for what has no container; Refused if it is not wanted; Unconfirmed, without `force`, if it stops a driver
    or other services."""
    names = tuple(s.name for s in current.containers_of(name))
    if not names:
        raise Invalid(f"restart {name}", "a meta-service has no container", "the services that it requests")
    if not any(current.statuses[n].wanted for n in names):
        held = next((n for n in names if n in current.decision.holds), "")
        if held:
            raise Refused(f"restart {name}", current.decision.holds[held], f"`rorg hold {held} --end`")
        cause = "it is not wanted, so there is nothing to restart"
        raise Refused(f"restart {name}", cause, f"`rorg request {name}`")
    if not force:
        _ask(f"restart {name}", by_restart(current.decision.situation, current.decision.memory, names))

    def edit(document: RequestsDocument) -> RequestsDocument:
        return replace(document, restarts={**document.restarts, **dict.fromkeys(names, stamp(now))})

    return _about(Change(edit, "restart", f"restart of {', '.join(names)}", names))


def _ask(what: str, affected: Affected) -> None:
    """Raises Unconfirmed if a person should know who is affected."""
    if affected.names:
        raise Unconfirmed(what, str(affected), "to confirm it with force", affected.names)


class RetryBody(Body):
    """What to retry."""

    services: Annotated[list[ServiceName], Field(min_length=1, max_length=300)] = Field(
        description="Services and groups with a failed change."
    )
    force: Force = False


def retry(current: Current, body: RetryBody, now: Moment) -> Change:
    """Asks at `now` to retry failed changes of services and groups; with a service, those
    of its set that keep it from its own change. Raises Missing; Refused for a name without a failed change;
    Unconfirmed, without `force`, if it replaces a driver or restarts other services."""
    desired, memory = current.decision.situation.desired, current.decision.memory
    services: list[str] = []
    for name in body.services:
        own = [s for s in current.containers_of(name) if memory.of(s.name).update.failed]
        if not own:
            ill = any(current.statuses[s.name].health is Health.DEGRADED for s in current.containers_of(name))
            remedy = f"`rorg restart {name}`" if ill else "`rorg get` for those of which one did"
            raise Refused(f"retry {name}", "no change of it failed", remedy)
        sets = (desired.sets.get(s.update.atomic, ()) if memory.of(s.name).update.drawn else () for s in own)
        services += [*(s.name for s in own), *(m for mates in sets for m in mates if memory.of(m).update.failed)]
    names = tuple(dict.fromkeys(services))
    if not body.force:
        _ask(f"retry {', '.join(body.services)}", by_restart(current.decision.situation, memory, names))

    def edit(document: RequestsDocument) -> RequestsDocument:
        return replace(document, retries={**document.retries, **dict.fromkeys(names, stamp(now.wall))})

    return _about(Change(edit, "retry", f"another try of {', '.join(names)}", names))


class HoldsBody(Body):
    """Several services: how long, and why."""

    services: Annotated[list[ServiceName], Field(min_length=1, max_length=300)]
    duration: Annotated[str, Field(max_length=20)] | None = Field(
        default=None, description="How long, such as 10m; null ends the holds."
    )
    reason: Short = ""
    force: Force = False


def hold(current: Current, body: HoldsBody, now: Moment) -> Change:
    """Holds services and groups, all of them or none, from `now`; without a duration, ends their holds. Raises Missing;
    Invalid for what has no container; Unconfirmed, without `force`, if it stops a driver or other services."""
    services: list[str] = []
    seconds = seconds_of(body.duration, "duration")
    for name in body.services:
        own = [s.name for s in current.containers_of(name)]
        if not own:
            cause = "a meta-service has no container to stop"
            raise Invalid(f"hold {name}", cause, "the services that it requests")
        services += own
    names = tuple(dict.fromkeys(services))
    if seconds is not None and not body.force:
        _ask(f"hold {', '.join(body.services)}", by_hold(current.decision.situation, current.decision.memory, names))

    def edit(document: RequestsDocument) -> RequestsDocument:
        kept = {n: h for n, h in document.holds.items() if seconds_left(h, now) > 0 and n not in names}
        more = {} if seconds is None else dict.fromkeys(names, begin_hold(now, seconds, body.reason))
        return replace(document, holds={**kept, **more})

    told = "no longer held" if seconds is None else f"held for {format_seconds(seconds)}: {body.reason}"
    return _about(Change(edit, "hold", f"{', '.join(names)} {told}", names))


def suspend(seconds: float | None, reason: str, now: Moment) -> Change:
    """Changes nothing for some seconds from `now`; without `seconds`, ends that."""
    asked = None if seconds is None else begin_hold(now, seconds, reason)
    told = "no longer suspended" if seconds is None else f"suspended for {format_seconds(seconds)}: {reason}"
    return Change(lambda document: replace(document, suspended=asked), "suspend", told)


def confirm(current: Current, names: tuple[str, ...]) -> Change:
    """Confirms the removal of what is withheld: exactly these names, until they are declared again. Raises Refused for
    what is not withheld."""
    withheld = current.decision.situation.withheld
    others = [n for n in names if n not in withheld]
    if others:
        raise Refused(f"confirm the removal of {', '.join(others)}", "it is not withheld", "`rorg diff` for what is")

    def edit(document: RequestsDocument) -> RequestsDocument:
        return replace(document, removals=tuple(dict.fromkeys((*document.removals, *names))))

    return _about(Change(edit, "removal", f"removal of {', '.join(names)} confirmed", names))


def down(keep_requests: bool, volumes: bool, forget: bool, suspended: str) -> Change:
    """Takes the robot down: stops and removes everything, then rorg ends. Requests are forgotten unless they are kept
    for the next run. `volumes`: removes its volumes too; `forget`: also its history. Raises Refused while rorg is
    suspended."""
    if suspended:
        raise Refused("take the robot down", f"rorg is {suspended}", "`rorg suspend --end` first")

    def edit(document: RequestsDocument) -> RequestsDocument:
        kept = document if keep_requests else RequestsDocument()
        return replace(kept, down=True, down_since="", purge=volumes, forget=forget)

    told = "the robot is taken down" + (" with its volumes" if volumes else "")
    told += ", its history is forgotten" if forget else ""
    return Change(edit, "down", told + (", its requests are kept" if keep_requests else ""))


def up() -> Change:
    """Brings a robot up after it was taken down."""
    return Change(RequestsDocument.up, "up", "the robot comes up again")


def _about(change: Change) -> Change:
    """The change, with its services named in its event."""
    return replace(change, about={"services": list(change.services)})


class Operation(NamedTuple):
    """An operation on services that the API, and commands with and without a running rorg, offer in the same way."""

    name: str
    """Of the permission that it needs, which only people have."""
    words: str
    """For "cannot X"."""
    body: type[Body]
    change: Callable[[Current, Any, Moment], Change]
    """Of the current robot, the body, and the present."""
    about: str
    """For the schema."""


OPERATIONS: Mapping[str, Operation] = {
    "POST /v1/retries": Operation(
        "retry",
        "retry failed changes",
        RetryBody,
        retry,
        "Retry failed changes of services without editing anything: all of them or none. If that replaces a driver or "
        "restarts other services, it needs `force`: the refusal names them in `confirm`.",
    ),
    "PUT /v1/holds": Operation(
        "hold",
        "hold services",
        HoldsBody,
        hold,
        "Keep services and groups from being active for a time, all of them or none; without a duration, end that. "
        "`force` as for one of them.",
    ),
}
"""By method and path. The answer names the services, in the form of `Held`."""
