"""Digests, options and labels of networks and volumes."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

from rorg.core.digest import canonical, declared_of, digest
from rorg.core.observed import LABEL_DECLARED, LABEL_OWNER, LABEL_SPEC, FoundObject
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
