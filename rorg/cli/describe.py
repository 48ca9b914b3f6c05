"""rorg describe"""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer
from rorg_client import calls

from rorg.cli.context import Context
from rorg.cli.kinds import KIND_OF, KINDS, service_name
from rorg.cli.names import complete_services
from rorg.cli.options import Output, RobotEngine, ServiceName
from rorg.cli.output import dump, echo, kind_behind, missing
from rorg.cli.terminal import printable
from rorg.errors import Invalid

DESCRIBED = (*KINDS["service"], *KINDS["group"])
"""Names of the kinds that have descriptions."""
NameAfterKind = Annotated[
    str,
    typer.Argument(
        help="Its name, if its kind comes first as with kubectl: describe service navigation.",
        parser=service_name,
        autocompletion=complete_services,
    ),
]


def command(context: RobotEngine, service: ServiceName, name: NameAfterKind = "", *, output: Output = "table") -> None:
    """Show everything about one service: its declaration and where it comes from (`sources`), its state, who wants
    it, its last events, and the last lines of its log.

    Example: rorg describe navigation
    """
    kind = _described_kind(service, name) if name else ""
    service = name or service
    context.view()  # for its notices, such as refused manifests
    client = context.client()
    if client:
        descriptions: list[dict[str, Any]] = client.do(calls.description(service))
    else:
        descriptions = _here(context, service)
    if kind:
        _check_kind(kind, service, descriptions)
    if output in ("json", "yaml"):
        dump(descriptions[0] if len(descriptions) == 1 else descriptions, output)
        return
    if output == "name":
        echo("\n".join(printable(entry["name"]) for entry in descriptions))
        return
    import yaml

    for entry in descriptions:
        echo(yaml.safe_dump(entry, sort_keys=False, width=120), end="")


def _described_kind(word: str, name: str) -> str:
    """`service` or `group`, as typed before a name. Raises Invalid for an unknown kind, and for one that has no
    descriptions."""
    if word not in KIND_OF and name in KIND_OF:
        raise kind_behind("describe", name, [word])
    if word not in KIND_OF:
        raise missing("kind", word, DESCRIBED)
    if word not in DESCRIBED:
        remedy = f"`rorg get {KIND_OF[word]} {printable(name)} -o yaml`"
        raise Invalid(f"describe the {word} '{printable(name)}'", "only services and groups have descriptions", remedy)
    return KIND_OF[word].removesuffix("s")


def _check_kind(kind: str, name: str, descriptions: list[dict[str, Any]]) -> None:
    """Raises Invalid for a name of the other kind. The descriptions of a group are those of its services."""
    found = "service" if [entry["name"] for entry in descriptions] == [name] else "group"
    if found != kind:
        raise Invalid(f"find the {kind} '{name}'", f"it is a {found}", f"`rorg describe {found} {name}`")


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
