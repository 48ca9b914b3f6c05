"""How everything is, as JSON: what the loop publishes, and what commands compute where no loop runs."""

from __future__ import annotations

from typing import Any

from rorg.core.decide import Decision
from rorg.core.pressure import MEASURES
from rorg.core.status import statuses
from rorg.manifest.catalog import Request


def snapshot(decision: Decision, about: dict[str, Any]) -> dict[str, Any]:
    """`about` is put in front: who runs, on which tree."""
    situation = decision.situation
    requests = (*situation.desired.catalog.requests, *decision.settled.requests)
    return {
        **about,
        "engine": {"complete": situation.observed.complete, "error": situation.observed.error},
        "suspended": situation.suspended,
        "requests": [request_json(r) for r in requests],
        "restarts": dict(situation.restarts),
        "pressure": pressure_json(decision),
        "plan": decision.plan.as_json(),
        "in_flight": {n: f.action.verb for n, f in decision.memory.in_flight.items()},
        "services": {n: s.as_json() for n, s in statuses(situation, decision.plan, decision.holds).items()},
    }


def request_json(request: Request) -> dict[str, Any]:
    return {"id": request.id, "requester": request.requester, "services": list(request.services),
            "reason": request.reason, "incarnation": request.incarnation, "standing": request.standing,
            "priority": request.priority, "ttl": request.ttl}


def pressure_json(decision: Decision) -> dict[str, Any]:
    """Measures in force, mildest first, and what was shed."""
    state = decision.memory.pressure
    return {"reason": state.reason, "measures": list(MEASURES[:state.level]),
            "shed": {s.service: s.reason for s in state.shed}}
