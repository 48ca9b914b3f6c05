"""rorg describe"""

from __future__ import annotations

import json
from typing import Any

from rorg_client import calls

from rorg.cli.context import Context
from rorg.cli.options import Output, RobotEngine, ServiceName
from rorg.cli.output import dump, echo
from rorg.cli.terminal import printable


def command(context: RobotEngine, service: ServiceName, output: Output = "table") -> None:
    """Show everything about one service: its declaration and where it comes from (`sources`), its state, who wants
    it, its last events, and the last lines of its log.

    Example: rorg describe navigation
    """
    context.view()  # for its notices, such as refused manifests
    client = context.client()
    if client:
        descriptions: list[dict[str, Any]] = client.do(calls.description(service))
    else:
        descriptions = _here(context, service)
    if output in ("json", "yaml"):
        dump(descriptions[0] if len(descriptions) == 1 else descriptions, output)
        return
    if output == "name":
        echo("\n".join(printable(entry["name"]) for entry in descriptions))
        return
    import yaml

    for entry in descriptions:
        echo(yaml.safe_dump(entry, sort_keys=False, width=120), end="")


def _here(context: Context, service: str) -> list[dict[str, Any]]:
    """Described by this process, if no rorg runs."""
    from rorg.api.description import describe
    from rorg.cli.offline import Local
    from rorg.history.database import reading
    from rorg.history.journal import Journal

    local = Local(context)
    with reading(context.state.journal) as database:
        described = describe(local.looked, service, Journal(database), context.engine, context.root, context.robot)
    descriptions: list[dict[str, Any]] = json.loads(context.masker.json(json.dumps(described)))
    return descriptions
