"""What networks and volumes are made from, and the labels by which they are known again."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

from rorg.core.digest import canonical, declared_of, digest
from rorg.core.found_objects import FoundObject
from rorg.core.observed import LABEL_DECLARED, LABEL_OWNER, LABEL_SPEC
from rorg.model.objects import EngineObject, Kind

LABELS: Mapping[str, str] = {"network": "rorg.io/network", "volume": "rorg.io/volume"}
"""Kind -> the label that holds the name in the manifest. A volume of ours without it is one that nobody named."""


def found_object(kind: Kind, called: str, id: str, labels: Mapping[str, str]) -> FoundObject:
    """From what the engine says of it."""
    owner = labels.get(LABEL_OWNER, "") if LABELS[kind] in labels else ""
    name, made_from = labels.get(LABELS[kind], ""), labels.get(LABEL_SPEC, "")
    return FoundObject(kind, called, id, owner, name, made_from, labels.get(LABEL_DECLARED, ""))


def object_digest(one: EngineObject) -> str:
    """Identity of what it is made from, as of a container's."""
    return digest(one.spec)


def declared_options(one: EngineObject) -> dict[str, Any]:
    """Its options by field, one for each option of the driver. These are hashed: a password may be among them, and this
    ends up in a label and in plans."""
    found = {k: v for k, v in one.spec.items() if k != "driver_opts"}
    for name, value in one.spec.get("driver_opts", {}).items():
        found[f"driver_opts.{name}"] = "sha256:" + hashlib.sha256(value.encode()).hexdigest()[:12]
    return found


def object_labels(one: EngineObject, owner: str) -> dict[str, str]:
    """What marks it as ours, beside the labels that are declared."""
    return {
        **one.spec.get("labels", {}),
        LABEL_OWNER: owner,
        LABELS[one.kind]: one.name,
        LABEL_SPEC: object_digest(one),
        LABEL_DECLARED: canonical(declared_options(one)),
    }


def changed_options(one: EngineObject, found: FoundObject) -> tuple[str, ...]:
    """Options that it was made with otherwise than is declared; empty where it is as declared."""
    if found.digest == object_digest(one):
        return ()
    was, now = declared_of(found.declared), declared_options(one)
    if not was and found.declared != canonical({}):
        return ("digest",)
    return tuple(sorted(k for k in {*was, *now} if was.get(k) != now.get(k)))
