"""A plan in all its forms, for the API and for commands that make it themselves."""

from __future__ import annotations

from typing import Any

from rorg.core.decide import Decision
from rorg.core.overview import Overview
from rorg.core.plan import Plan


def shown(decision: Decision, plan: Plan, unified: bool) -> dict[str, Any]:
    """A plan of a decision, in all its forms."""
    situation, catalog = decision.situation, decision.situation.desired.catalog
    overview = Overview(situation, plan)
    return {
        "fingerprint": catalog.fingerprint,
        "withheld": sorted(situation.withheld),
        "probed": sorted(name for name, service in catalog.services.items() if service.ready),
        "empty": plan.empty,
        "text": plan.text(),
        "services": overview.as_json(),
        "unified": overview.unified() if unified else {},
        "suspended": situation.suspended,
        "plan": plan.as_json(),
    }
