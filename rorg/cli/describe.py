"""rorg describe"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rorg.cli.options import EngineName, Output, ServiceName, StateDirectory
from rorg.cli.output import echo

if TYPE_CHECKING:
    from rorg.cli.context import Context
    from rorg.model.catalog import Catalog


def command(
    service: ServiceName, state_dir: StateDirectory = None, engine: EngineName = None, output: Output = "table"
) -> None:
    """Everything about one service: what is declared, and by which profile or manifest (`sources`), how it is, who
    wants it, what happened to it last."""
    import json

    from rorg.cli.context import Context
    from rorg.cli.output import check_form, dump, missing

    check_form(output, ("table", "json", "yaml"))
    context = Context(state_dir, engine)
    catalog, view = context.catalog(), context.view()
    if service in view.get("withheld", ()):  # no manifest declares it any more, and it is kept as it was
        catalog = context.decision(catalog).situation.desired.catalog
    if service in catalog.groups:
        names = list(catalog.groups[service].services)
    elif service in catalog.services:
        names = [service]
    else:
        raise missing("service", service, {*catalog.services, *catalog.groups})
    found = [
        {**_declared(catalog, name, view["services"].get(name, {})), "events": _events(context, name)} for name in names
    ]
    if output != "table":
        dump(found[0] if len(found) == 1 else found, output)
        return
    import yaml

    for entry in found:
        echo(yaml.safe_dump(json.loads(json.dumps(entry)), sort_keys=False, width=120), end="")


def _declared(catalog: Catalog, name: str, status: dict[str, Any]) -> dict[str, Any]:
    """A service as its manifest says, with how it is; of its environment the names alone."""
    declared = catalog.services[name]
    spec = {k: v for k, v in (declared.spec or {}).items() if k != "environment"}
    spec["environment"] = sorted((declared.spec or {}).get("environment", {}))
    return {
        "name": name,
        "description": declared.description,
        "manifest": str(declared.where),
        "needs": list(declared.needs),
        "conflicts": list(declared.conflicts),
        "always_on": declared.always_on,
        "idle": {"action": declared.idle.action, "linger": declared.idle.linger},
        "restart": declared.restart,
        "priority": declared.priority,
        "driver": declared.driver,
        "needed_by": sorted(s.name for s in catalog.services.values() if name in s.needs),
        "status": status,
        "container": spec,
        "sources": dict(declared.origins),
    }


def _events(context: Context, name: str, most: int = 10) -> list[str]:
    from rorg.store.journal import Journal

    entries = [e for e in Journal(context.state.journal).since(0) if e.get("service") == name]
    return [f"{e['at']} {e['message']}" for e in entries[-most:]]
