"""Digests, options, labels and status of networks and volumes."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

from rorg.core.digest import canonical, declared_of, digest
from rorg.core.observed import LABEL_DECLARED, LABEL_OWNER, LABEL_SPEC, FoundObject
from rorg.core.plan import Plan
from rorg.core.situation import Situation
from rorg.model.objects import EngineObject, Kind

LABELS: Mapping[str, str] = {"network": "rorg.io/network", "volume": "rorg.io/volume"}
"""Kind -> the label with the name in the manifest. One of rorg's volumes without it is anonymous."""


def found_object(kind: Kind, called: str, id: str, labels: Mapping[str, str]) -> FoundObject:
    """Return a network or volume from the engine's description."""
    owner = labels.get(LABEL_OWNER, "") if LABELS[kind] in labels else ""
    name, made_from = labels.get(LABELS[kind], ""), labels.get(LABEL_SPEC, "")
    return FoundObject(kind, called, id, owner, name, made_from, labels.get(LABEL_DECLARED, ""))


def object_digest(declared: EngineObject) -> str:
    """Return the identity of its options, like a container's digest."""
    return digest(declared.spec)


def declared_options(declared: EngineObject) -> dict[str, Any]:
    """Return its options by field, with each option of the driver as a field of its own. Driver options are hashed:
    they may contain a password, and the result ends up in labels and plans."""
    options = {k: v for k, v in declared.spec.items() if k != "driver_opts"}
    for name, value in declared.spec.get("driver_opts", {}).items():
        options[f"driver_opts.{name}"] = "sha256:" + hashlib.sha256(value.encode()).hexdigest()[:12]
    return options


def object_labels(declared: EngineObject, owner: str) -> dict[str, str]:
    """Return declared labels, and those that mark it as rorg's."""
    return {
        **declared.spec.get("labels", {}),
        LABEL_OWNER: owner,
        LABELS[declared.kind]: declared.name,
        LABEL_SPEC: object_digest(declared),
        LABEL_DECLARED: canonical(declared_options(declared)),
    }


def changed_options(declared: EngineObject, existing: FoundObject) -> tuple[str, ...]:
    """Return the options in which an existing object differs from its manifest; empty if none."""
    if existing.digest == object_digest(declared):
        return ()
    old_options, new_options = declared_of(existing.declared), declared_options(declared)
    if not old_options and existing.declared != canonical({}):
        return ("digest",)
    return tuple(sorted(k for k in {*old_options, *new_options} if old_options.get(k) != new_options.get(k)))


PRESENT, NONE, FOREIGN, UNKNOWN = "present", "none", "foreign", "unknown"
"""It exists; it does not exist, or not yet; it exists but belongs to someone else; the engine has not answered or has
no such objects."""


def object_views(situation: Situation, plan: Plan) -> list[dict[str, Any]]:
    """Return one entry per object, sorted by kind and name, as plain JSON."""
    objects, declared = situation.observed.objects, situation.desired.objects
    reasons = {name: texts[-1] for name, texts in plan.reasons().items()}
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
