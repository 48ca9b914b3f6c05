"""rorg request"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer
from rorg_client import check_id

from rorg.cli.kinds import Seconds, duration
from rorg.cli.operations import Served, operating
from rorg.cli.options import Output, RobotEngine, ServiceNames, Timeout, Wait
from rorg.cli.output import note, print_rows
from rorg.errors import Invalid
from rorg.model.units import format_duration

if TYPE_CHECKING:
    from rorg.cli.offline import Local

Id = Annotated[
    str, typer.Option(help="Id of the request; the same id again replaces it. Default: the first service's name.")
]
Ttl = Annotated[
    float | None,
    typer.Option(help="Lease, such as 10s: the request ends after that time unless it is sent again.", parser=duration),
]
Priority = Annotated[
    int | None,
    typer.Option(
        help="Raise its services to this priority while the request lasts. Default: their own.", min=0, max=100
    ),
]


def command(
    context: RobotEngine,
    services: ServiceNames,
    *,
    requester: Annotated[str, typer.Option("--as", help="The service that asks.")] = "developer",
    id: Id = "",
    reason: Annotated[str, typer.Option(help="Why; shown by `rorg why`.")] = "",
    ttl: Ttl = None,
    priority: Priority = None,
    output: Output = "table",
    wait: Wait = False,
    rollback: Annotated[
        bool, typer.Option("--rollback", help="With --wait: withdraw the request if waiting fails, or on Ctrl-C.")
    ] = False,
    timeout: Timeout = Seconds(60),
) -> None:
    """Request services. They run, with everything they need, until the request is released.

    Example: rorg request navigation --id tour --ttl 10m --wait
    """
    check_id(id or "request")
    if ttl is not None and ttl <= 0:
        raise Invalid("request", "a lease of 0 s ends immediately", "--ttl 10s, or no --ttl for a request without end")
    if rollback and not wait:
        raise Invalid("request", "--rollback needs --wait", "to add --wait")
    chosen = list(dict.fromkeys(services))
    name, robot = id or chosen[0], operating(context)
    check_id(name)
    if wait:
        robot.check_wait(f"wait for {', '.join(chosen)}")
    lease = format_duration(ttl) if ttl else None
    asked = Asked(robot, name, requester, rollback)
    robot.put_request(name, requester, {"services": chosen, "reason": reason, "priority": priority, "ttl": lease})
    row = {"id": name, "requester": requester, "services": chosen, "priority": priority, "ttl": ttl, "reason": reason}
    text = f"request '{name}' of {requester}: {', '.join(chosen)}"
    print_rows([row], output, ("id", "requester", "services"), ("priority", "ttl", "reason"), text=text)
    if wait:
        with asked:
            robot.wait(chosen, timeout)


class Asked:
    """Waits for a request in its block. If that fails, it reports what happens to the request."""

    def __init__(self, robot: Served | Local, id: str, requester: str, rollback: bool) -> None:
        self.robot, self.id, self.requester, self.rollback = robot, id, requester, rollback
        self.before: dict[str, Any] | None = next(
            (r for r in robot.requests(id) if rollback and r["requester"] == requester), None
        )

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is None:
            return
        if self.rollback:
            self._roll_back()
            told = "is as it was before" if self.before else "is withdrawn"
        else:
            whose = "" if self.requester == "developer" else f" --as {self.requester}"
            told = f"stays; `rorg release {self.id}{whose}` withdraws it"
        text = f"request '{self.id}' {told}"
        if isinstance(error, Exception):
            error.add_note(text)  # shown after the error
        else:
            note(text)

    def _roll_back(self) -> None:
        if self.before:
            lease = format_duration(self.before["ttl"]) if self.before["ttl"] else None
            body = {**{k: self.before[k] for k in ("services", "reason", "priority")}, "ttl": lease}
            self.robot.put_request(self.id, self.requester, body)
        else:
            self.robot.release(self.id, self.requester)
