"""Situations for tests of the planner: services, what is observed of them, what is remembered, and the plan."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from rorg.core.desired import desire
from rorg.core.digest import canonical, declared_fields, digest
from rorg.core.incremental import plan_all
from rorg.core.memory import Memory, Progress
from rorg.core.observed import Container, Observed
from rorg.core.situation import Situation
from rorg.core.wanted import Cause
from rorg.model.catalog import Catalog, Service
from rorg.model.policy import Policy
from rorg.model.probe import Probe

NOW, EARLIER = 100.0, 90.0
STARTED = "2026-01-01T12:00:00Z"
SPEC = {"image": "x"}
BASE = Service("base", spec=SPEC)
ARM = Service("arm", spec=SPEC, needs=("base",))
PROBED = replace(BASE, ready=Probe("tcp", 80, timeout=30.0))
RUN = f"base@{STARTED}"


def box(service: str = "base", state: str = "running", spec: Any = SPEC, **more: Any) -> Container:
    made = {"digest": digest(spec), "declared": canonical(declared_fields(spec)), "started_at": STARTED, **more}
    return Container(**{"id": service, "name": service, "service": service, "state": state, **made})


def up(name: str = "base", **more: Any) -> Progress:
    """It has been ready for ten seconds."""
    known = {"running_since": EARLIER, "ready": True, "was_ready": True, "well_since": EARLIER}
    return replace(Progress(incarnation=f"{name}@{STARTED}", **known), **more)


def situation(
    *services: Service, seen: tuple[Container, ...] = (), policy: Policy = Policy(), known: Any = None, **more: Any
) -> Situation:
    """All services are wanted, and what runs is ready, unless something else is said."""
    declared = {service.name: service for service in services}
    progress = {c.service: up(c.service) for c in seen if c.state == "running"}
    facts = {
        "desired": desire(Catalog(services=declared, policy=policy)),
        "observed": Observed(seen, looked={c.id: NOW for c in seen}),
        "memory": Memory({**progress, **(known or {})}),
        "wanted": {name: (Cause("always_on"),) for name in declared},
        "urgent": frozenset(),
    }
    return Situation(**{"now": NOW, "owner": "robot", **facts, **more})


def planned(*services: Service, **more: Any) -> list[str]:
    """The actions and waitings, a line each."""
    plan = plan_all(situation(*services, **more)).plan()
    lines = plan.text().splitlines()[:-1] if not plan.empty else []
    return [" ".join(line.split()) for line in lines]
