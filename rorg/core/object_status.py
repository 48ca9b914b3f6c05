"""How the networks and volumes of a robot are: those that are declared, and those of ours that are left."""

from __future__ import annotations

from typing import Any

from rorg.core.found_objects import FoundObject
from rorg.core.plan import Plan
from rorg.core.situation import Situation
from rorg.model.objects import EngineObject

PRESENT, NONE, FOREIGN, UNKNOWN = "present", "none", "foreign", "unknown"
"""It is there; it is not, or not yet; what is there is somebody else's; the engine has not said, or makes none."""


def object_views(situation: Situation, plan: Plan) -> list[dict[str, Any]]:
    """One for each, by kind and name, in plain JSON values."""
    objects, declared = situation.observed.objects, situation.desired.objects
    reasons: dict[str, str] = {w.service: w.reason for w in plan.waitings}
    found = [_declared(situation, one, reasons.get(name, "")) for name, one in declared.items()]
    keys = {one.key for one in declared.values()}
    for key, left in objects.found.items() if objects else ():
        if left.owner == situation.owner and key not in keys:
            found.append(_left(left, reasons.get(key, "")))
    return sorted(found, key=lambda view: (view["kind"], view["name"], view["engine_name"]))


def _declared(situation: Situation, one: EngineObject, message: str) -> dict[str, Any]:
    objects = situation.observed.objects
    there = objects.found.get(one.key) if objects else None
    known = there is not None or (objects is not None and one.key in objects.asked)
    ours = there is not None and there.owner == situation.owner
    state = NONE if there is None else PRESENT if ours or one.external else FOREIGN
    return {
        "kind": one.kind,
        "name": one.name,
        "engine_name": one.called,
        "state": state if known else UNKNOWN,
        "external": one.external,
        "declared": True,
        "ours": ours,
        "services": list(situation.desired.users.get(one.subject, ())),
        "message": message,
    }


def _left(left: FoundObject, message: str) -> dict[str, Any]:
    """One of ours that no manifest declares any more."""
    return {
        "kind": left.kind,
        "name": left.name or left.called,
        "engine_name": left.called,
        "state": PRESENT,
        "external": False,
        "declared": False,
        "ours": True,
        "services": [],
        "message": message,
    }
