"""The machines of a robot: what they tell each other, and how the links between them are."""

from __future__ import annotations

import asyncio
from typing import Annotated, Any

from fastapi import FastAPI, Path, Query
from fastapi.responses import Response
from pydantic import AfterValidator, BaseModel, Field, TypeAdapter

from rorg.api.callers import Who, accepted, needs
from rorg.api.current import missing
from rorg.api.operations import Operations
from rorg.api.permissions import Caller
from rorg.api.read_routes import text
from rorg.core.links import Answer, Renewal, Report
from rorg.core.received import within_bounds
from rorg.errors import Forbidden, Invalid, Refused
from rorg.model.machines import LONGEST_LEASE, SHORTEST_LEASE

ANSWER = TypeAdapter[Answer](Annotated[Answer, AfterValidator(within_bounds)])
REPORT = TypeAdapter[Report](Annotated[Report, AfterValidator(within_bounds)])
Received = Annotated[Renewal, AfterValidator(within_bounds)]
LONGEST_POLL = 10.0
"""Seconds for which a machine waits for a new report."""
MachineName = Annotated[str, Path(max_length=64)]


class MachineView(BaseModel):
    """One computer of the robot, as this one sees it."""

    name: str
    address: str
    here: bool = Field(description="Whether it is this one.")
    link: str = Field(description="up, lost, or none if it has not answered yet; up for this one.")
    reason: str = Field(description="Why nothing is known of it; empty while the link is up.")
    since: float | None = Field(description="Seconds since it last answered.")
    lease: float = Field(description="For how many seconds requests count there after the link has failed.")
    services: int = Field(description="How many services its manifests give to it.")
    requests: int = Field(description="How many of its requests count here.")


def add_machines(app: FastAPI, operations: Operations) -> None:
    """Adds the routes."""

    @app.get("/v1/machines", dependencies=[needs("read")], response_model=list[MachineView])
    async def machines() -> Response:
        """The machines of the robot, with their links; empty if it has only one."""
        return text(views(operations))

    @app.put("/v1/machines/{name}/renewal", dependencies=[needs("link")], response_model=Answer)
    def renew(name: MachineName, renewal: Received, caller: Who) -> Response:
        """One machine tells another all its live requests, which count for the given time."""
        allow_link(caller, name)
        if renewal.machine != name or not SHORTEST_LEASE <= renewal.duration <= LONGEST_LEASE:
            raise Invalid("take the renewal", f"it is of {renewal.machine}, for {renewal.duration} s")
        return Response(ANSWER.dump_json(operations.machines.receive(renewal)), media_type="application/json")

    @app.get("/v1/machines/{name}/report", dependencies=[needs("link")], response_model=Report)
    async def report(
        name: MachineName, caller: Who, after: Annotated[int, Query(ge=-1)] = -1, incarnation: int = -1
    ) -> Response:
        """How the services of this machine are, for another machine. The answer comes immediately if there is a later
        report than `after` of this `incarnation`; otherwise as soon as there is one, and after 10 s at the latest."""
        allow_link(caller, name)
        machines = operations.machines
        deadline = asyncio.get_running_loop().time() + LONGEST_POLL
        while not operations.ending:
            event, left = operations.next_pass(), deadline - asyncio.get_running_loop().time()
            if machines.own(name) != incarnation or machines.version > after or left <= 0:
                break
            await asyncio.wait([asyncio.ensure_future(event.wait())], timeout=left)
        return Response(REPORT.dump_json(machines.report(name)), media_type="application/json")

    @app.post("/v1/services/{name}/take", dependencies=[needs("take")])
    async def take(name: str, caller: Who) -> Response:
        """Confirms, in place of a machine that does not answer, that a service of this machine no longer runs there."""
        return accepted(await asyncio.to_thread(taken, operations, caller, name))


def taken(operations: Operations, caller: Caller, name: str) -> int:
    """Takes a service over; returns the generation. Raises Missing and Refused."""
    catalog, here = operations.catalog, operations.machines.here
    service = catalog.services.get(name)
    if service is None:
        raise missing(name, set(catalog.services))
    if service.machine != here or not here:
        where = f"it belongs to {service.machine}" if service.machine else "the robot has only one machine"
        raise Refused(f"take {name}", where, "`machine:` in its manifest")
    operations.machines.take([name])
    told = f"{name} was taken over without a confirmation of the other machines (by {caller.author})"
    operations.recorder.event("taken", told, caller.person, service=name, author=caller.author)
    return operations.changed()


def allow_link(caller: Caller, name: str) -> None:
    """Raises Forbidden unless this is that machine."""
    if caller.kind != "machine" or caller.service != name:
        raise Forbidden(f"speak for {name}", f"the certificate is that of {caller.certificate or 'nobody'}")


def views(operations: Operations) -> list[dict[str, Any]]:
    """The machines, this one first."""
    machines, catalog, now = operations.machines, operations.catalog, operations.machines.now()
    shown = []
    for name, machine in sorted(catalog.machines.items(), key=lambda item: (item[0] != machines.here, item[0])):
        link, lease = machines.links.get(name), machines.granted.get(name)
        here = name == machines.here
        lost = link is None or not link.live(now)
        at = link.confirmed_at if link else None
        shown.append(
            {
                "name": name,
                "address": machine.address,
                "here": here,
                "link": "up" if here or not lost else "none" if at is None else "lost",
                "reason": "" if here or not lost else machines.trouble.get(name, ""),
                "since": None if at is None else round(now - at, 1),
                "lease": machine.lease,
                "services": sum(s.machine == name for s in catalog.services.values()),
                "requests": len(lease.renewal.requests) if lease and lease.live(now) else 0,
            }
        )
    return shown
