"""Reads the status that an rorg publishes: which services are ready, and why others are not."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from rorg.model.causes import Cause, causes
from rorg.model.codes import BLOCKED, NO_IMAGE

SETTLED = 0.5
"""Seconds that a service without a probe must run before `rorg apply` counts it as well: a service that crashes at its
start does so within them."""

READY, PROVEN = "ready", "proven"
"""What `rorg apply --wait` waits for: probes have answered, or the bake of every change is over as well."""
UNTRIED = "applied, but {}; rorg tries an idle service when something requests it"
"""What `rorg apply --wait=proven` says of a change that waiting does not prove."""


def is_ready(service: dict[str, Any]) -> bool:
    """Whether a service of a view is ready."""
    return any(c["type"] == "Ready" and c["status"] == "True" for c in service["conditions"])


def condition(service: dict[str, Any], kind: str) -> dict[str, str]:
    """A condition of a service of a view; empty if it has none of that type."""
    return next((c for c in service["conditions"] if c["type"] == kind), {"status": "", "reason": "", "message": ""})


def hopeless(view: dict[str, Any], names: Iterable[str]) -> dict[str, str]:
    """The wanted services among these for which waiting is hopeless, with the reason: an attempt failed, or the service
    ended and is not restarted."""
    reasons: dict[str, str] = {}
    if not view.get("engine", {}).get("complete", True):
        return reasons  # earlier failures may be over when the engine answers
    for name in names:
        service = view["services"].get(name)
        if service is None or not service["wanted"] or service["state"] == "meta":
            continue
        said = [w for w in view["plan"]["waitings"] if w["service"] == name]
        failed = [w["reason"] for w in said if w.get("code") in ("failed", NO_IMAGE, BLOCKED)]
        stalled, ready = condition(service, "Stalled"), condition(service, "Ready")
        over = ready["reason"] in ("Failed", "OutOfMemory") and condition(service, "Reconciling")["status"] == "False"
        updated = condition(service, "Updated")
        if updated["status"] == "False":
            reasons[name] = f"its change failed ({updated['message']}); {_left(service)}"
        elif failed or stalled["status"] == "True" or over:
            reasons[name] = "; ".join(failed) or stalled["message"] or ready["message"] or ready["reason"]
    return reasons


def _left(service: dict[str, Any]) -> str:
    """What is left of a service whose change failed. A container in sync is none to which rorg has gone back: it has a
    changed file or probe, so it is not as it was even if it runs."""
    if service["state"] not in ("running", "paused"):
        return "it does not run"
    return "it stays as it was" if service["sync"] == "OutOfSync" else "its container goes on"


def failure(failed: Mapping[str, str]) -> str:
    """What hopeless() found, each cause once."""
    return "; ".join(map(str, causes(failed.items())))


def unready(view: dict[str, Any], names: Iterable[str]) -> str:
    """The first reason why one of these services is not ready, with all that have it; empty if all are ready."""
    readiness = late(view, names)
    return str(view.get("suspended") or readiness[0]) if readiness else ""


def late(view: dict[str, Any], names: Iterable[str]) -> list[Cause]:
    """Why services among these are not ready, each cause once."""
    return causes((name, why) for name in names if (why := _missing(view, name)))


def _missing(view: dict[str, Any], name: str) -> str:
    """Why a service is not ready; empty if it is."""
    service = view["services"].get(name)
    if service is None:
        return "not declared yet"
    if service["state"] == "meta" or (service["wanted"] and is_ready(service)):
        return ""
    ready = condition(service, "Ready")
    waits = [w["reason"] for w in view["plan"]["waitings"] if w["service"] == name]
    return str(service["held"] or "; ".join(waits) or ready["message"] or ready["reason"])
