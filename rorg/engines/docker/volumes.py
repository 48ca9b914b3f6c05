"""Unnamed volumes: those of an image's VOLUME lines and of `volumes: [/path]`. They belong to the service, not to one
container, so each new container takes over those of the previous one, and they are removed with the service."""

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
    """Give names to the unnamed volumes of a container that will be created, those that its image declares included:
    the names that `before`, the id of an older container of the service, has at that path; otherwise one made from
    service and path."""
    host = body["HostConfig"]
    if host.get("VolumesFrom"):
        return  # only the engine knows which paths these bring along
    mounts = host.get("Mounts") or []
    unnamed = {m["Target"] for m in mounts if m["Type"] == "volume" and not m.get("Source")}
    targets = {posixpath.normpath(t) for t in {*image, *body.get("Volumes", {}), *unnamed} - _taken(host)}
    if not targets:
        return
    previous = client.find(f"/containers/{before}/json") if before else None
    known = unnamed_volumes(previous) if previous else {}
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
    """Paths where something else is mounted."""
    binds = {b.split(":")[1] for b in host.get("Binds") or []}
    named = {m["Target"] for m in host.get("Mounts") or [] if m["Type"] != "volume" or m.get("Source")}
    paths = {*binds, *named, *(host.get("Tmpfs") or {})}
    return paths | {f"{t}/" for t in paths}


def unnamed_volumes(data: Mapping[str, Any]) -> dict[str, str]:
    """Path -> unnamed volume, from a container's inspection. Engines give them names of 64 digits, and so does rorg."""
    declared = declared_of((data["Config"].get("Labels") or {}).get(LABEL_DECLARED, "")).get("volumes", [])
    said = {str(v.get("source", "") if isinstance(v, Mapping) else v).partition(":")[0] for v in declared}
    return {
        posixpath.normpath(m["Destination"]): m["Name"]
        for m in data.get("Mounts") or []
        if m["Type"] == "volume" and re.fullmatch(r"[0-9a-f]{64}", m.get("Name") or "") and m["Name"] not in said
    }


def remove_container(client: Client, container: str, volumes: bool) -> None:
    """`volumes`: remove its unnamed volumes too, except those that another container uses."""
    names = list(unnamed_volumes(client.get(f"/containers/{container}/json")).values()) if volumes else []
    client.delete(f"/containers/{container}")
    for name in names:
        with contextlib.suppress(Refused):
            client.delete(f"/volumes/{name}")
