"""The container of a service, for commands that go into it by way of the engine, as Docker's own do."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rorg.cli.context import Context
    from rorg.core.observed import Container


def container_of(context: Context, service: str, what: str) -> Container:
    """The one that runs, or ran last. Raises Invalid for an unknown name, a group, and where there is none."""
    from rorg.cli.output import missing
    from rorg.errors import Invalid, NotReady

    found = [c for c in context.engine().list() if c.service and c.service == service]
    if found:
        return max(found, key=lambda c: (c.alive, c.started_at))
    client = context.client()
    services = {s["service"] for s in client.services()} if client else set(context.catalog().services)
    if service in services:
        raise NotReady(what, f"{service} has no container", f"`rorg request {service} --wait` first")
    groups = {g["name"]: g["services"] for g in context.groups()}
    if service in groups:
        raise Invalid(what, f"{service} is a group", "one of " + ", ".join(groups[service]))
    raise missing("service", service, services)


def run_inside(context: Context, service: str, command: Sequence[str], stdin: bool, terminal: bool) -> int:
    """Exit code of a command in a service's container. `stdin`, `terminal`: it has ours in any case; without, it has
    both where this is a terminal. Raises NotReady where the service does not run."""
    from rorg.errors import Invalid, NotReady

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
