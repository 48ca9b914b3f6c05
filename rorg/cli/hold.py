"""rorg hold"""

from __future__ import annotations

import typer

from rorg.cli.options import End, EngineName, For, Reason, ServiceNames, StateDirectory


def command(services: ServiceNames, duration: For = None, reason: Reason = "", end: End = False,
            state_dir: StateDirectory = None, engine: EngineName = None) -> None:
    """Keep services from being active, whoever requests them, for a time; it ends by itself."""
    import time
    from dataclasses import replace

    from rorg.cli.context import Context
    from rorg.cli.output import missing
    from rorg.errors import Invalid
    from rorg.manifest.catalog import Hold
    from rorg.manifest.scalars import format_seconds
    from rorg.store.requests_file import Asked

    context = Context(state_dir, engine)
    catalog = context.catalog()
    names = [m for s in services for m in catalog.members(s) if not catalog.services[m].meta]
    for service in services:
        if not catalog.members(service):
            raise missing("service", service, {*catalog.services, *catalog.groups})
    if not names:
        raise Invalid(f"hold {', '.join(services)}", "a meta-service has no container that could be ceased",
                      "the services that it requests")
    if not end and not duration:
        raise Invalid(f"hold {', '.join(names)}", "it must end by itself", "--for 10m")
    now = time.time()
    told = f"{', '.join(names)} " + ("no longer held" if end else f"held for {format_seconds(duration or 0.0)}")
    client = context.client()
    if client:
        for name in names:
            client.unhold(name) if end else client.hold(name, duration or 0.0, reason)
        typer.echo(told)
        return

    def edit(asked: Asked) -> Asked:
        kept = {n: h for n, h in asked.holds.items() if h.until > now and n not in names}
        return replace(asked, holds=kept if end else {
            **kept, **dict.fromkeys(names, Hold(now + (duration or 0.0), reason))})

    context.change(edit)
    typer.echo(told)
