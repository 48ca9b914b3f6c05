"""Talk to rorg from a Python program. Standard library only.

    import rorg_client as rorg

    with rorg.request("navigation", wait=30):
        drive()

The request is kept by a heartbeat while the block runs, through restarts of rorg too, and released at its end. When the
program dies, rorg drops it: together with its container, or when the lease runs out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Callable

from rorg_client.address import Address, default_address
from rorg_client.calls import PATIENCE, TTL, manifest_text
from rorg_client.client import Client
from rorg_client.errors import Error, Forbidden, Invalid, NotFound, NotReady, Refused, Unreachable
from rorg_client.loss import Loss
from rorg_client.names import check_id
from rorg_client.request import Request

if TYPE_CHECKING:
    from rorg_client.aio import AsyncClient, AsyncRequest
    from rorg_client.types import (
        Condition,
        Event,
        GroupView,
        ManifestView,
        Readiness,
        RequestView,
        ServiceUsage,
        ServiceView,
        Spec,
        Usage,
        Why,
    )

__all__ = [
    "PATIENCE",
    "TTL",
    "Address",
    "AsyncClient",
    "AsyncRequest",
    "Client",
    "Condition",
    "Error",
    "Event",
    "Forbidden",
    "GroupView",
    "Invalid",
    "Loss",
    "ManifestView",
    "NotFound",
    "NotReady",
    "Readiness",
    "Refused",
    "Request",
    "RequestView",
    "ServiceUsage",
    "ServiceView",
    "Spec",
    "Unreachable",
    "Usage",
    "Why",
    "check_id",
    "client",
    "default_address",
    "manifest_text",
    "request",
]

_shared: Client | None = None


def __getattr__(name: str) -> Any:
    """Imports what needs asyncio, and the types, when they are used: asyncio takes as long as everything else
    together."""
    if name in ("AsyncClient", "AsyncRequest"):
        from rorg_client import aio

        return getattr(aio, name)
    if name in __all__:
        from rorg_client import types

        return getattr(types, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def client() -> Client:
    """The client of this program, on the default address."""
    global _shared
    if _shared is None:
        _shared = Client()
    return _shared


def request(
    *services: str,
    id: str | None = None,
    wait: float | None = None,
    ttl: float | None = TTL,
    reason: str = "",
    priority: int | None = None,
    requester: str | None = None,
    on_lost: Callable[[Loss], None] | None = None,
) -> Request:
    """Client.request on the default address."""
    return client().request(
        *services, id=id, wait=wait, ttl=ttl, reason=reason, priority=priority, requester=requester, on_lost=on_lost
    )
