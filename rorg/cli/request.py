"""rorg request"""

from __future__ import annotations

from typing import Annotated

from rorg.cli.options import EngineName, Option, Output, ServiceNames, StateDirectory, Timeout, Wait, duration
from rorg.cli.output import check_form, print_rows


def command(
    services: ServiceNames,
    requester: Annotated[str, Option(names=("--as",), help="The service that asks.")] = "developer",
    id: Annotated[
        str,
        Option(
            names=("--id",), help="Id of the request; the same id again replaces it. Default: the first service's name."
        ),
    ] = "",
    reason: Annotated[str, Option(names=("--reason",), help="For people, shown by `rorg why`.")] = "",
    ttl: Annotated[
        float | None,
        Option(
            names=("--ttl",),
            parser=duration,
            metavar="DURATION",
            show_default=False,
            help=("Lease: it is dropped after so long, unless the same request is sent again."),
        ),
    ] = None,
    priority: Annotated[
        int | None,
        Option(
            names=("--priority",),
            least=0,
            most=100,
            show_default=False,
            help=("Raises what it asks for, where not everything can run. Default: that of the services."),
        ),
    ] = None,
    output: Output = "table",
    wait: Wait = False,
    timeout: Timeout = 60.0,
    state_dir: StateDirectory = None,
    engine: EngineName = None,
) -> None:
    """Ask for services; they run, with all that they need, until the request is released.

    Example: rorg request navigation --id tour --ttl 10m --wait
    """
    from rorg_client import check_id

    from rorg.cli.context import Context
    from rorg.cli.operating import operating
    from rorg.errors import Invalid
    from rorg.model.units import format_duration

    check_form(output)
    check_id(id or "request")
    if ttl is not None and ttl <= 0:
        raise Invalid("request", "a lease of 0 s would be over at once", "--ttl 10s, or none for no end")
    chosen = list(dict.fromkeys(services))
    name, robot = id or chosen[0], operating(Context(state_dir, engine))
    check_id(name)
    if wait:
        robot.waiting(f"wait for {', '.join(chosen)}")
    lease = format_duration(ttl) if ttl else None
    robot.put_request(name, requester, {"services": chosen, "reason": reason, "priority": priority, "ttl": lease})
    row = {"id": name, "requester": requester, "services": chosen, "priority": priority, "ttl": ttl, "reason": reason}
    text = f"request '{name}' of {requester}: {', '.join(chosen)}"
    print_rows([row], output, ("id", "requester", "services"), ("priority", "ttl", "reason"), text=text)
    if wait:
        robot.wait(chosen, timeout)
