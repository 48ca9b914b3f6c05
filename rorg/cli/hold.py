"""rorg hold"""

from __future__ import annotations

from rorg.cli.options import End, EngineName, For, Reason, ServiceNames, StateDirectory
from rorg.cli.output import echo


def command(
    services: ServiceNames,
    duration: For = None,
    reason: Reason = "",
    end: End = False,
    state_dir: StateDirectory = None,
    engine: EngineName = None,
) -> None:
    """Keep services from being active, whoever requests them, for a time; it ends by itself."""
    from rorg.cli.context import Context
    from rorg.errors import Invalid
    from rorg.model.units import format_seconds

    if not end and not duration:
        raise Invalid(f"hold {', '.join(services)}", "it must end by itself", "--for 10m")
    context = Context(state_dir, engine)
    client = context.client()
    if client and end:
        for name in services:
            client.unhold(name)
        names = list(services)
    elif client:
        names = [held for name in services for held in client.hold(name, duration or 0.0, reason)]
    else:
        names = _write(context, services, duration, reason)
    echo(f"{', '.join(names)} " + ("no longer held" if end else f"held for {format_seconds(duration or 0.0)}"))


def _write(context: object, services: list[str], duration: float | None, reason: str) -> list[str]:
    """Into the requests file, where no rorg serves. Without a duration the holds end."""
    import time
    from dataclasses import replace

    from rorg.cli.output import missing
    from rorg.errors import Invalid
    from rorg.model.catalog import Hold
    from rorg.store.requests_document import RequestsDocument

    catalog = context.catalog()  # type: ignore[attr-defined]
    names = [m for s in services for m in catalog.members(s) if not catalog.services[m].meta]
    for service in services:
        if not catalog.members(service):
            raise missing("service", service, {*catalog.services, *catalog.groups})
    if not names:
        raise Invalid(
            f"hold {', '.join(services)}",
            "a meta-service has no container that could be ceased",
            "the services that it requests",
        )
    now = time.time()

    def edit(document: RequestsDocument) -> RequestsDocument:
        kept = {n: h for n, h in document.holds.items() if h.until > now and n not in names}
        return replace(
            document, holds={**kept, **({} if duration is None else dict.fromkeys(names, Hold(now + duration, reason)))}
        )

    context.change(edit)  # type: ignore[attr-defined]
    return names
