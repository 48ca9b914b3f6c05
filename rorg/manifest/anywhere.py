"""Services that may run on any node of a Docker Swarm: what their containers are made from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from rorg.manifest.documents import Source
from rorg.model.catalog import Service
from rorg.model.diagnostics import Diagnostic
from rorg.model.machines import ANYWHERE
from rorg.model.volumes import OF_TREE, Mount, mounted_at, read_mount, same_path

RESTARTS = {"always": "always", "on-failure": "on-failure", "never": "no"}
"""`restart` of a Service -> the option of a container by which the Swarm restarts it: a node that is lost restarts
nothing, and rorg is no part of the Swarm."""


def anywhere(service: Service, source: Source) -> Service:
    """Return the service as the Swarm gets it. Its mounts of the tree travel with it, because no node has the tree."""
    spec, mounts = dict(service.options), {same_path(m.rpartition(":")[2]) for m in source.spec.mounts or ()}
    if mounts:
        spec["volumes"] = [_of_tree(read_mount(v)) if mounted_at(v) in mounts else v for v in spec.get("volumes", ())]
    reserve: dict[str, Any] = {"cpu": service.cpu, "memory": service.memory}
    spec |= {"restart": RESTARTS[service.restart]}
    spec |= {"placement": list(source.spec.placement)} if source.spec.placement else {}
    spec |= {"reserve": {k: v for k, v in reserve.items() if v}} if any(reserve.values()) else {}
    return replace(service, spec=spec)


def _of_tree(mount: Mount) -> dict[str, Any]:
    return {"type": OF_TREE, "source": mount.source, "target": mount.target, "read_only": True}


def check_placement(service: Service, source: Source) -> Iterator[Diagnostic]:
    """Report constraints of a service that belongs to one machine."""
    if source.spec.placement and service.machine != ANYWHERE:
        message = f"'{service.name}' belongs to one machine, so nothing places it"
        yield Diagnostic(source.where("spec", "placement"), message, f"machine: {ANYWHERE}")
