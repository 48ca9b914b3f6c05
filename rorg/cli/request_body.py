"""A request as it is sent."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def body_of(request: Mapping[str, Any]) -> dict[str, Any]:
    """What would send a request again, of one as the API shows it."""
    from rorg.model.units import format_duration

    ttl = format_duration(request["ttl"]) if request["ttl"] else None
    return {**{k: request[k] for k in ("services", "reason", "priority")}, "ttl": ttl}
