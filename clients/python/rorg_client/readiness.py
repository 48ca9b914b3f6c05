"""The readiness of services, if rorg itself does not report it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rorg_client.errors import NotReady

if TYPE_CHECKING:
    from rorg_client.types import Readiness, ServiceView


def readiness_of(service: ServiceView) -> Readiness:
    """The readiness of a service, from its state."""
    ready = next((c for c in service["conditions"] if c["type"] == "Ready"), None)
    fine = service["state"] == "meta" or bool(service["wanted"] and ready and ready["status"] == "True")
    why = "" if fine else service["held"] or (ready and (ready["message"] or ready["reason"])) or "not ready"
    return {"ready": fine, "incarnation": service["incarnation"], "reason": why}


def not_restarted(name: str, seconds: float) -> NotReady:
    return NotReady(
        f"cannot wait for the restart of {name}",
        f"{name} has not started again after {seconds:g} s",
        "`rorg why` for the reasons",
        "not-ready",
        504,
    )
