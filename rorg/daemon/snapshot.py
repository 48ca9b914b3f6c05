"""How everything is, as JSON: what the loop publishes, and what commands compute where no loop runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rorg.core.decide import Decision
from rorg.core.follow import Followed
from rorg.core.memory import Memory, Progress
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
        "withheld": dict(situation.withheld),
        "requests": [request_json(r) for r in requests],
        "restarts": sorted(situation.restarts),
        "pressure": pressure_json(decision),
        "plan": decision.plan.as_json(),
        "runs": {n: {"run": p.followed.run, "needs": dict(p.followed.needs), "stopped": p.stopped}
                 for n, p in decision.memory.progress.items() if p.followed.run or p.stopped},
        "in_flight": {n: f.action.verb for n, f in decision.memory.in_flight.items()},
        "services": {n: s.as_json() for n, s in statuses(situation, decision.plan, decision.holds).items()},
    }


def recall(view: Mapping[str, Any] | None) -> Memory:
    """What of a loop's memory outlives it: on which runs of their needs services count, and which runs it ended
    itself. `view` is what it published; what is not as it should be is passed over."""
    runs = view.get("runs") if isinstance(view, Mapping) else None
    found = {}
    for name, known in runs.items() if isinstance(runs, Mapping) else ():
        if isinstance(known, Mapping) and isinstance(known.get("needs"), Mapping):
            needs = {str(need): str(run) for need, run in known["needs"].items()}
            found[name] = Progress(followed=Followed(str(known.get("run", "")), needs),
                                   stopped=str(known.get("stopped", "")))
    return Memory(found)


def request_json(request: Request) -> dict[str, Any]:
    return {"id": request.id, "requester": request.requester, "services": list(request.services),
            "reason": request.reason, "incarnation": request.incarnation, "standing": request.standing,
            "priority": request.priority, "ttl": request.ttl}


def pressure_json(decision: Decision) -> dict[str, Any]:
    """Measures in force, mildest first, and what was shed."""
    state = decision.memory.pressure
    return {"reason": state.reason, "measures": [m for m in MEASURES if state.in_force(m)], "helpless": state.helpless,
            "shed": {s.service: s.reason for s in state.shed}}
