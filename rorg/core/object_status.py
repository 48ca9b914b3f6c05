"""The status of networks and volumes: declared ones, and those of rorg's that are left over."""

from __future__ import annotations

from typing import Any

from rorg.core.observed import FoundObject
from rorg.core.plan import Plan
from rorg.core.situation import Situation
from rorg.model.objects import EngineObject

PRESENT, NONE, FOREIGN, UNKNOWN = "present", "none", "foreign", "unknown"
"""It exists; it does not exist, or not yet; it exists but belongs to someone else; the engine has not answered or has
no such objects."""


def object_views(situation: Situation, plan: Plan) -> list[dict[str, Any]]:
    """Return one entry per object, sorted by kind and name, as plain JSON."""
    objects, declared = situation.observed.objects, situation.desired.objects
    reasons: dict[str, str] = {w.service: w.reason for w in plan.waitings}
    views = [_declared(situation, declared_object, reasons.get(name, "")) for name, declared_object in declared.items()]
    keys = {declared_object.key for declared_object in declared.values()}
    for key, left in objects.found.items() if objects else ():
        if left.owner == situation.owner and key not in keys:
            views.append(_left(left, reasons.get(key, "")))
    return sorted(views, key=lambda view: (view["kind"], view["name"], view["engine_name"]))


def _declared(situation: Situation, declared_object: EngineObject, message: str) -> dict[str, Any]:
    objects = situation.observed.objects
    existing = objects.found.get(declared_object.key) if objects else None
    known = existing is not None or (objects is not None and declared_object.key in objects.asked)
    ours = existing is not None and existing.owner == situation.owner
    state = NONE if existing is None else PRESENT if ours or declared_object.external else FOREIGN
    return {
        "kind": declared_object.kind,
        "name": declared_object.name,
        "engine_name": declared_object.called,
        "state": state if known else UNKNOWN,
        "external": declared_object.external,
        "declared": True,
        "ours": ours,
        "services": list(situation.desired.users.get(declared_object.subject, ())),
        "message": message,
    }


def _left(left: FoundObject, message: str) -> dict[str, Any]:
    """Return the entry of an object of rorg's that is no longer declared."""
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
