"""rorg why"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rorg.cli.operations import operating
from rorg.cli.options import Output, RobotEngine, ServiceName
from rorg.cli.output import print_rows
from rorg.cli.terminal import printable
from rorg.model.causes import verb_before
from rorg.model.health import Health

if TYPE_CHECKING:
    from rorg_client.types import RequestView, Why


def command(context: RobotEngine, service: ServiceName, output: Output = "table") -> None:
    """Show why a service is active, as the chain of requests and needs that leads to it, or why it is not.

    Example: rorg why navigation
    """
    # The running rorg answers even if the manifests on the disk have mistakes.
    explanations = operating(context).why(service)
    rows = [
        {**e, "waits": "; ".join(e["waits"]), "because": " < ".join(c["service"] for c in e["chain"])}
        for e in explanations
    ]
    print_rows(
        rows,
        output,
        ("service", "wanted", "state", "because", "waits"),
        full=explanations[0] if len(explanations) == 1 else explanations,
        text="\n".join(line for entry in explanations for line in _lines(entry)),
    )


def _lines(entry: Why) -> list[str]:
    """The lines, each printable."""
    return [printable(line) for line in _texts(entry)]


def _texts(entry: Why) -> list[str]:
    name = entry["service"]
    health = Health(entry["health"])
    kept_out, state = health.kept_out, f"is {entry['state']}, and"
    if entry["state"] == "none":
        state = "has no container, and is"
    elif health == Health.COMPLETED:
        state = "has completed, and is"
    lines = [f"{name} {state} {_word(entry)}:"]
    lines += [f"  {'  ' * depth}{link['text']}" for depth, link in enumerate(entry["chain"])]
    lines += [f"  {_request(r)}" for r in entry["requests"] if entry["wanted"] or kept_out]
    if not (entry["wanted"] or kept_out or entry["waits"]):
        lines += [f"  {_request(r)}, but {r['requester']} is not active" for r in entry["requests"]]
        if not entry["requests"]:
            lines.append("  no request names it")
        if entry["needed_by"]:
            lines.append(f"  no service that needs it is active: {', '.join(entry['needed_by'])}")
    lines += [f"  it {verb_before(reason)}{reason}" for reason in entry["waits"]]
    lines += [f"  {rival['text']} is active" for rival in entry["rivals"]]
    lines += [f"  to let it in: `{command}`" for command in entry["remedies"]]
    lines += [f"  caution: {text}" for text in entry["cautions"]]
    return lines


def _word(entry: Why) -> str:
    if entry["wanted"]:
        return "wanted"
    return entry["health"].lower() if Health(entry["health"]).kept_out else "not wanted"


def _request(request: RequestView) -> str:
    said = f"request '{request['id']}' of {request['requester']} names it"
    facts = [
        f"priority {request['priority']}" if request.get("priority") is not None else "",
        f"lease of {request['ttl']:g} s" if request.get("ttl") else "",
        "standing" if request["standing"] else "",
        f"because {request['reason']}" if request["reason"] else "",
    ]
    return ", ".join([said, *filter(None, facts)])
