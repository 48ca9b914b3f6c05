"""Networks of the Swarm: overlay networks, which reach all of its nodes."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from typing import Any

from rorg.core.objects import LABELS, found_object
from rorg.core.observed import LABEL_OWNER, FoundObjects
from rorg.engines.docker.client import Client
from rorg.engines.docker.create import other_rorg
from rorg.engines.docker.errors import Refused
from rorg.engines.docker.objects import network_body
from rorg.errors import EngineError

RELEASED = 3.0
"""Seconds for which a network may still be in use after the last service that used it was removed."""


def find(client: Client, owner: str, keys: Collection[str]) -> FoundObjects:
    """Return all of `owner`, and every one whose name is one of `keys`. There are no volumes: each node has its own."""
    rows = client.get("/networks", filters={"scope": ["swarm"]})
    found = [found_object("network", row["Name"], row["Id"], row.get("Labels") or {}) for row in rows]
    asked = frozenset(keys)
    objects = {one.key: one for one in found if one.owner == owner or one.key in asked}
    return FoundObjects(objects, asked, complete=True)


def make(client: Client, name: str, spec: Mapping[str, Any], labels: Mapping[str, str]) -> None:
    """Make one."""
    client.post("/networks/create", {**network_body(name, spec, labels), "Driver": spec.get("driver", "overlay")})


def remove(client: Client, name: str, owner: str) -> None:
    """Remove one of `owner`, if it still exists. Errors as those of Objects."""
    what, data = f"remove the network {name}", client.find(f"/networks/{name}")
    if data is None:
        return
    labels = data.get("Labels") or {}
    if labels.get(LABEL_OWNER) != owner or LABELS["network"] not in labels:
        whose = other_rorg(labels, owner)
        raise EngineError(what, f"it belongs to {whose}" if whose else "it is not rorg's", kind="foreign")
    until = time.monotonic() + RELEASED
    while True:
        try:
            client.delete(f"/networks/{data['Id']}")
        except Refused as no:
            if no.status == 404:
                return
            if "in use" not in no.text:
                raise
            if time.monotonic() > until:
                raise EngineError(what, no.text, "to remove the services that use it", kind="in_use") from no
            time.sleep(0.2)
        else:
            return
