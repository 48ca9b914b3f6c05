"""rorg why"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rorg.cli.options import EngineName, Output, ServiceName, StateDirectory
from rorg.cli.output import echo

if TYPE_CHECKING:
    from rorg_client.types import RequestView, Why


def command(
    service: ServiceName, state_dir: StateDirectory = None, engine: EngineName = None, output: Output = "table"
) -> None:
    """Why a service is active: the chain from a root to it. Or why it is not."""
    from rorg.cli.context import Context
    from rorg.cli.output import dump

    context = Context(state_dir, engine)
    client = context.client()
    # The running rorg knows, even while the manifests on the disk have a mistake.
    found = client.why(service) if client else _found(context, service)
    dependants = (
        {}
        if client
        else {
            n: [s.name for s in context.catalog().services.values() if n in s.needs]
            for n in (e["service"] for e in found)
        }
    )
    if output != "table":
        dump(found[0] if len(found) == 1 else found, output)
        return
    for entry in found:
        echo("\n".join(_lines(entry, sorted(dependants.get(entry["service"], [])))))


def _found(context: Any, service: str) -> list[Why]:
    """What the API would say, computed where no rorg serves."""
    from rorg.cli.context import condition
    from rorg.cli.output import missing

    catalog, view = context.catalog(), context.view()
    found: list[Why] = []
    names = catalog.members(service) or ((service,) if service in view["services"] else ())
    if not names:
        raise missing("service", service, {*catalog.services, *catalog.groups})
    for name in names:
        status = view["services"].get(name)
        if status is None:
            raise missing("service", name, view["services"])
        requests = [r for r in view["requests"] if any(name in catalog.members(s) for s in r["services"])]
        waits = [w["reason"] for w in view["plan"]["waitings"] if w["service"] == name]
        found.append(
            {
                "service": name,
                "wanted": status["wanted"],
                "state": status["state"],
                "chain": condition(status, "Requested")["message"].split(" <- ") if status["wanted"] else [],
                "requests": requests,
                "waits": waits,
            }
        )
    return found


def _lines(entry: Why, dependants: list[str]) -> list[str]:
    name = entry["service"]
    lines = [f"{name} is {entry['state']}, and " + ("wanted:" if entry["wanted"] else "not wanted:")]
    lines += [f"  {'  ' * depth}{link}" for depth, link in enumerate(entry["chain"])]
    lines += [f"  {_request(r)}" for r in entry["requests"] if entry["wanted"]]
    if not entry["wanted"] and not entry["waits"]:
        lines += [f"  {_request(r)}, but {r['requester']} is not active" for r in entry["requests"]]
        if not entry["requests"]:
            lines.append("  no request names it")
        if dependants:
            lines.append(f"  none of those that need it is active: {', '.join(dependants)}")
    lines += [f"  it waits: {reason}" for reason in entry["waits"]]
    return lines


def _request(request: RequestView) -> str:
    said = f"request '{request['id']}' of {request['requester']} names it"
    facts = [
        f"priority {request['priority']}" if request.get("priority") is not None else "",
        f"lease of {request['ttl']:g} s" if request.get("ttl") else "",
        "standing" if request["standing"] else "",
        f"because {request['reason']}" if request["reason"] else "",
    ]
    return ", ".join([said, *filter(None, facts)])
