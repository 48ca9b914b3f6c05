"""The client of rorg is a package of its own, rorg_client (clients/python); this is its former name."""

from __future__ import annotations

from typing import Any

import rorg_client
from rorg_client import (
    PATIENCE,
    TTL,
    Client,
    Error,
    Forbidden,
    Invalid,
    NotFound,
    NotReady,
    Refused,
    Request,
    Unreachable,
    check_id,
    client,
    request,
)

__all__ = [
    "PATIENCE",
    "TTL",
    "Client",
    "Error",
    "Forbidden",
    "Invalid",
    "NotFound",
    "NotReady",
    "Refused",
    "Request",
    "Unreachable",
    "check_id",
    "client",
    "request",
]


def __getattr__(name: str) -> Any:
    """Everything else: AsyncClient, for one, which is only imported where it is used."""
    return getattr(rorg_client, name)
