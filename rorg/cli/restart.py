"""rorg restart"""

from __future__ import annotations

import sys

import typer

from rorg.cli.options import EngineName, ServiceName, StateDirectory, Timeout, Wait, Yes


def command(service: ServiceName, yes: Yes = False, wait: Wait = False, timeout: Timeout = 60.0,
            state_dir: StateDirectory = None, engine: EngineName = None) -> None:
    """Stop and start a service (or each of a group) that is active. Drivers ask first."""
    from dataclasses import replace

    from rorg.cli.context import Context, unready
    from rorg.cli.output import missing
    from rorg.daemon.wiring import wall_clock
    from rorg.errors import Refused

    context = Context(state_dir, engine)
    catalog = context.catalog()
    names = [n for n in catalog.members(service) if not catalog.services[n].meta]
    if not names:
        raise missing("service", service, {*catalog.services, *catalog.groups})
    drivers = [n for n in names if catalog.services[n].driver]
    if drivers and not yes:
        if not sys.stdin.isatty():
            raise Refused(f"restart {service}", f"{', '.join(drivers)} moves hardware and nobody was asked", "--yes")
        if not typer.confirm(f"{', '.join(drivers)} moves hardware. Restart?", err=True):
            raise Refused(f"restart {service}", "you said no")
    asked_at = wall_clock()
    client = context.client()
    if client:
        client.restart(service, force=True)
    else:
        context.change(lambda asked: replace(asked, restarts={**asked.restarts, **{n: asked_at for n in names}}))
    typer.echo(f"restart of {', '.join(names)} asked for")
    if wait and context.state.owner() is not None:
        def done(view: dict) -> str:
            active = {n for n in names if view["services"][n]["wanted"]}
            old = [n for n in active if view["services"][n]["started_at"] < asked_at]
            return f"{old[0]} has not started again" if old else unready(view, active)

        context.wait(f"the restart of {service}", done, timeout)
