"""rorg restart"""

from __future__ import annotations

import sys

from rorg.cli.options import EngineName, ServiceName, StateDirectory, Timeout, Wait, Yes
from rorg.cli.output import confirm, echo


def command(
    service: ServiceName,
    yes: Yes = False,
    wait: Wait = False,
    timeout: Timeout = 60.0,
    state_dir: StateDirectory = None,
    engine: EngineName = None,
) -> None:
    """Stop and start a service (or each of a group) that is active. Drivers ask first."""
    from rorg_client import Refused as RefusedByApi

    from rorg.cli.context import Context

    context = Context(state_dir, engine)
    client = context.client()
    if client:
        try:
            names = client.restart(service, force=yes)
        except RefusedByApi as refused:
            _confirm(service, refused.cause)
            names = client.restart(service, force=True)
    else:
        names = _write(context, service, yes)
    echo(f"restart of {', '.join(names)} asked for")
    if wait and client:
        active = [n for n in names if client.service(n)["wanted"]]
        client.wait(*active, timeout=timeout)


def _confirm(service: str, why: str) -> None:
    """Asks the person at the terminal. Raises Refused."""
    from rorg.errors import Refused

    if not sys.stdin.isatty():
        raise Refused(f"restart {service}", f"{why} and nobody was asked", "--yes")
    if not confirm(f"{why}. Restart?"):
        raise Refused(f"restart {service}", "you said no")


def _write(context: object, service: str, yes: bool) -> list[str]:
    """Into the requests file, where no rorg serves."""
    from dataclasses import replace

    from rorg.cli.output import missing
    from rorg.host.clock import wall_clock

    catalog = context.catalog()  # type: ignore[attr-defined]
    names = [n for n in catalog.members(service) if not catalog.services[n].meta]
    if not names:
        raise missing("service", service, {*catalog.services, *catalog.groups})
    drivers = [n for n in names if catalog.services[n].driver]
    if drivers and not yes:
        _confirm(service, f"{', '.join(drivers)} moves hardware")
    context.change(  # type: ignore[attr-defined]
        lambda document: replace(document, restarts={**document.restarts, **dict.fromkeys(names, wall_clock())})
    )
    return names
