"""rorg exec"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rorg.cli.context import Context
from rorg.cli.kinds import service_name
from rorg.cli.names import complete_services
from rorg.cli.options import RobotEngine
from rorg.cli.output import missing, note
from rorg.errors import Invalid, NotReady

if TYPE_CHECKING:
    from rorg.core.observed import Container

Service = Annotated[
    str, typer.Argument(help="A running service.", parser=service_name, autocompletion=complete_services)
]
NO_PROGRAM = 127


def command(
    context: RobotEngine,
    service: Service,
    command: Annotated[list[str], typer.Argument(help="The command, after `--`.")],
    interactive: Annotated[
        bool,
        typer.Option("-i", "--interactive", help="Pass standard input to the command; a terminal is always passed."),
    ] = False,
    terminal: Annotated[
        bool,
        typer.Option(
            "-t", "--tty", help="Fail without a terminal. Default: the command gets a terminal if there is one here."
        ),
    ] = False,
) -> None:
    """Run a command inside a service and exit with its exit code.

    Example: rorg exec navigation -- rosnode list
    """
    if not command[0]:
        raise Invalid(f"run a command in {service}", "it has no name", f"`rorg exec {service} -- COMMAND`")
    code = run_inside(context, service, command, interactive, terminal)
    if code == NO_PROGRAM:
        note(f"rorg: {command[0]} in {service} gave 127: no such program; try `rorg shell {service}` to look around")
    sys.exit(code)


def container_of(context: Context, service: str, what: str) -> Container:
    """The container of a service that runs, or ran last. Raises Invalid for an unknown name and for a group, and
    NotReady if the service has no container."""
    containers = [c for c in context.engine().list() if c.service and c.service == service]
    if containers:
        return max(containers, key=lambda c: (c.alive, c.started_at))
    client = context.client()
    views: dict[str, Any] = {s["service"]: s for s in client.services()} if client else {}
    services = set(views) or set(context.catalog().services)
    machine = views.get(service, {}).get("machine", "")
    if client and machine and not next(m["here"] for m in client.call("GET", "/v1/machines") if m["name"] == machine):
        raise NotReady(what, f"{service} belongs to the machine {machine}", f"the same command on {machine}")
    if service in services:
        raise NotReady(what, f"{service} has no container", f"`rorg request {service} --wait` first")
    groups = {g["name"]: g["services"] for g in context.groups()}
    if service in groups:
        raise Invalid(what, f"{service} is a group", "one of " + ", ".join(groups[service]))
    raise missing("service", service, services)


def run_inside(context: Context, service: str, command: Sequence[str], stdin: bool, terminal: bool) -> int:
    """The exit code of a command in a service's container. `stdin`, `terminal`: pass ours in any case; otherwise both
    are passed if this is a terminal. Raises NotReady if the service does not run."""
    what = f"run {command[0]} in {service}"
    ours = sys.stdin.isatty() and sys.stdout.isatty()
    if terminal and not ours:
        raise Invalid(what, "this is not a terminal", "it without -t")
    container = container_of(context, service, what)
    remedy = f"`rorg request {service} --wait` first"
    if container.state == "paused":
        raise NotReady(what, f"{service} is paused", remedy)
    if container.state != "running":
        ended = f", exit code {container.exit_code}" if container.exit_code is not None else ""
        raise NotReady(what, f"{service} does not run ({container.state}{ended})", remedy)
    return context.engine().attach(container.id, command, ours, stdin or ours)
