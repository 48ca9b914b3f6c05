"""rorg logs"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Annotated

from rorg.cli.options import EngineName, Option, ServiceName, StateDirectory


def command(
    service: ServiceName,
    follow: Annotated[bool, Option(names=("-f", "--follow"), help="Go on with what comes.")] = False,
    tail: Annotated[int | None, Option(names=("--tail",), least=0, help="Only the last so many lines.")] = None,
    state_dir: StateDirectory = None,
    engine: EngineName = None,
) -> None:
    """Print what a service wrote; lines of a group's members come one service after the other."""
    from rorg.cli.context import Context
    from rorg.cli.output import missing
    from rorg.errors import Invalid

    context = Context(state_dir, engine)
    client = context.client()
    if client:
        names = tuple(entry["service"] for entry in client.why(service))
    else:
        catalog = context.catalog()
        names = catalog.members(service)
        if not names:
            raise missing("service", service, {*catalog.services, *catalog.groups})
    if follow and len(names) > 1:
        raise Invalid(f"follow the logs of {service}", "it is a group", "one of " + ", ".join(names))
    containers = {c.service: c for c in sorted(context.engine().list(), key=lambda c: (c.alive, c.started_at))}
    if not any(n in containers for n in names):
        raise Invalid(f"read the logs of {service}", "it has no container yet", "`rorg request` or `rorg apply`")
    for name in names:
        if name in containers:
            _show(context.engine().logs(containers[name].id, follow, tail))


def _show(chunks: Iterable[bytes]) -> None:
    """As they are, where a program or a file takes them; a terminal gets lines and colours, and obeys nothing else."""
    from rorg.cli.terminal import LogText

    log = LogText() if sys.stdout.isatty() else None
    try:
        for chunk in chunks:
            sys.stdout.buffer.write(log.text(chunk).encode() if log else chunk)
            sys.stdout.buffer.flush()
    finally:
        if log:
            sys.stdout.buffer.write(log.text(b"", end=True).encode())
            sys.stdout.buffer.flush()
