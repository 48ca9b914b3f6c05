"""rorg request"""

from __future__ import annotations

from typing import Annotated, Any

from rorg.cli.options import EngineName, Option, ServiceNames, StateDirectory, Timeout, Wait, duration
from rorg.cli.output import echo


def command(
    services: ServiceNames,
    requester: Annotated[str, Option(names=("--as",), help="The service that asks.")] = "developer",
    id: Annotated[
        str,
        Option(
            names=("--id",), help="Id of the request; the same id again replaces it. Default: the first service's name."
        ),
    ] = "",
    reason: Annotated[str, Option(names=("--reason",), help="For people, shown by `rorg why`.")] = "",
    ttl: Annotated[
        float | None,
        Option(
            names=("--ttl",),
            parser=duration,
            metavar="DURATION",
            show_default=False,
            help=("Lease: it is dropped after so long, unless the same request is sent again."),
        ),
    ] = None,
    priority: Annotated[
        int | None,
        Option(
            names=("--priority",),
            least=0,
            most=100,
            show_default=False,
            help=("Raises what it asks for, where not everything can run. Default: that of the services."),
        ),
    ] = None,
    wait: Wait = False,
    timeout: Timeout = 60.0,
    state_dir: StateDirectory = None,
    engine: EngineName = None,
) -> None:
    """Ask for services; they run, with all that they need, until the request is released."""
    from rorg_client import check_id

    from rorg.cli.context import Context
    from rorg.errors import Invalid

    check_id(id or "request")
    if ttl is not None and ttl <= 0:
        raise Invalid("request", "a lease of 0 s would be over at once", "--ttl 10s, or none for no end")
    context, chosen = Context(state_dir, engine), tuple(dict.fromkeys(services))
    name, client = id or chosen[0], context.client()
    if client:
        _ask(client, name, requester, {"services": list(chosen), "reason": reason, "priority": priority}, ttl)
    else:
        _write(context, name, requester, chosen, reason, ttl, priority)
    echo(f"request '{name}' of {requester}: {', '.join(chosen)}")
    if wait and client:
        client.wait(*chosen, timeout=timeout)
    elif wait:
        _wait(context, name, requester, chosen, timeout)


def _ask(client: Any, name: str, requester: str, body: dict[str, Any], ttl: float | None) -> None:
    """Through the running rorg."""
    from urllib.parse import quote, urlencode

    from rorg.model.units import format_duration

    client.call(
        "PUT",
        f"/v1/requests/{quote(name)}?{urlencode({'requester': requester})}",
        {**body, "ttl": format_duration(ttl) if ttl else None},
    )


def _write(
    context: Any,
    name: str,
    requester: str,
    chosen: tuple[str, ...],
    reason: str,
    ttl: float | None,
    priority: int | None,
) -> None:
    """Into the requests file, where no rorg serves."""
    from rorg.core.requests import problems
    from rorg.errors import Invalid, Refused
    from rorg.host.clock import wall_clock
    from rorg.model.catalog import Request
    from rorg.store.requests_document import RequestsDocument

    catalog = context.catalog()
    request = Request(
        name,
        requester,
        chosen,
        reason,
        _incarnation(context, catalog, requester),
        priority=priority,
        ttl=ttl,
        renewed=wall_clock() if ttl else "",
    )

    def put(document: RequestsDocument) -> RequestsDocument:
        found = problems(catalog, document.requests, request)
        if found:
            cause, remedy = found[0]
            kind = Refused if "conflict" in cause or "does not fit" in cause else Invalid
            raise kind(f"request {', '.join(chosen)}", "; ".join(c for c, _ in found), remedy)
        return document.put(request)

    context.change(put)


def _wait(context: Any, name: str, requester: str, chosen: tuple[str, ...], timeout: float) -> None:
    """By what the rorg that owns the robot publishes."""
    from rorg.cli.context import unready
    from rorg.model.graph import closure

    catalog = context.catalog()
    asked = [m for s in chosen for m in catalog.members(s)]
    names = [*asked, *sorted(closure(catalog.services, asked) - set(asked))]

    def done(view: dict[str, Any]) -> str:
        known = any(r["id"] == name and r["requester"] == requester for r in view["requests"])
        return unready(view, names) if known else "the request has not been read yet"

    context.wait(", ".join(chosen), done, timeout)


def _incarnation(context: Any, catalog: Any, requester: str) -> str | None:
    """The run of the requester that the request belongs to; None for those that have no container."""
    from rorg.errors import Refused

    service = catalog.services.get(requester)
    if service is None or service.meta:
        return None
    status = context.view()["services"].get(requester, {})
    if not status.get("incarnation"):
        raise Refused(
            f"request as {requester}",
            f"{requester} is {status.get('state', 'unknown')}, and a request belongs to a run of its requester",
            "to request it first, or to leave out --as",
        )
    return str(status["incarnation"])
