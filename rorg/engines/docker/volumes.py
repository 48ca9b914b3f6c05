"""Volumes that nobody named: those of an image's VOLUME lines and of `volumes: [/path]`. They belong to the service,
not to one container of it, so each new container gets those of the one before, and they go only with the service."""

from __future__ import annotations

import contextlib
import hashlib
import posixpath
import re
from collections.abc import Collection, Mapping
from typing import Any

from rorg.core.digest import declared_of
from rorg.core.observed import LABEL_DECLARED, LABEL_OWNER, LABEL_SERVICE
from rorg.engines.docker.client import Client
from rorg.engines.docker.errors import Refused

Body = dict[str, Any]


def keep_volumes(client: Client, body: Body, image: Collection[str], before: str) -> None:
    """Names the unnamed volumes of a container to be created, those that its image declares too: as `before`, the id of
    an older container of the service, has them; else by a name that is always the same for a service and a path."""
    host = body["HostConfig"]
    if host.get("VolumesFrom"):
        return  # which paths these bring along is for the engine to know
    mounts = host.get("Mounts") or []
    unnamed = {m["Target"] for m in mounts if m["Type"] == "volume" and not m.get("Source")}
    targets = {posixpath.normpath(t) for t in {*image, *body.get("Volumes", {}), *unnamed} - _taken(host)}
    if not targets:
        return
    known = _known(client, before) if before else {}
    owner, service = body["Labels"][LABEL_OWNER], body["Labels"][LABEL_SERVICE]
    for target in sorted(targets):
        name = known.get(target)
        if name is None:
            name = hashlib.sha256(f"{owner}/{service}{target}".encode()).hexdigest()
            said = {LABEL_OWNER: owner, LABEL_SERVICE: service}
            client.post("/volumes/create", {"Name": name, "Driver": host.get("VolumeDriver"), "Labels": said})
        there = next((m for m in mounts if posixpath.normpath(m["Target"]) == target), None)
        if there is None:
            there = {"Type": "volume", "Target": target}
            host.setdefault("Mounts", []).append(there)
        there["Source"] = name
    body.pop("Volumes", None)


def _taken(host: Mapping[str, Any]) -> set[str]:
    """Paths at which something else is mounted."""
    binds = {b.split(":")[1] for b in host.get("Binds") or []}
    named = {m["Target"] for m in host.get("Mounts") or [] if m["Type"] != "volume" or m.get("Source")}
    found = {*binds, *named, *(host.get("Tmpfs") or {})}
    return found | {f"{t}/" for t in found}


def _known(client: Client, container: str) -> dict[str, str]:
    """Path -> the unnamed volume that a container has there."""
    try:
        return unnamed_volumes(client.get(f"/containers/{container}/json"))
    except Refused as no:
        if no.status == 404:
            return {}
        raise


def unnamed_volumes(data: Mapping[str, Any]) -> dict[str, str]:
    """Path -> volume, of a container's inspection. An engine names them itself, by 64 digits, and so do we."""
    declared = declared_of((data["Config"].get("Labels") or {}).get(LABEL_DECLARED, "")).get("volumes", [])
    said = {str(v.get("source", "") if isinstance(v, Mapping) else v).partition(":")[0] for v in declared}
    return {
        posixpath.normpath(m["Destination"]): m["Name"]
        for m in data.get("Mounts") or []
        if m["Type"] == "volume" and re.fullmatch(r"[0-9a-f]{64}", m.get("Name") or "") and m["Name"] not in said
    }


def remove_container(client: Client, container: str, volumes: bool) -> None:
    """With its unnamed volumes, or without; those that another container still has stay."""
    names = list(unnamed_volumes(client.get(f"/containers/{container}/json")).values()) if volumes else []
    client.delete(f"/containers/{container}")
    for name in names:
        with contextlib.suppress(Refused):
            client.delete(f"/volumes/{name}")
