"""The `deploy` section of a service: what of it is more than a swarm's."""

from __future__ import annotations

from typing import Any

from rorg.importing.compose_keys import DEPLOY, RESOURCES
from rorg.importing.compose_options import gpus
from rorg.importing.compose_work import Work, size


def deployed(work: Work, name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """(`resources` of the service, options of its container)."""
    said = work.project.services[name].get("deploy") or {}
    place = ("services", name, "deploy")
    work.check(DEPLOY, said, *place, shown="deploy.")
    resources = said.get("resources") or {}
    for part in ("limits", "reservations"):
        keys = {f"{part}.{key}": value for key, value in (resources.get(part) or {}).items()}
        known = {key: value for key, value in keys.items() if RESOURCES.get(key) and RESOURCES[key].how != "translated"}
        for key in known:
            message = f"deploy.resources.{key} is not carried over: {RESOURCES[key].why}"
            work.note(message, *place, "resources", *key.split("."))
    limits, reserved = resources.get("limits") or {}, resources.get("reservations") or {}
    container: dict[str, Any] = {}
    if limits.get("cpus"):
        container["cpus"] = float(limits["cpus"])
    if limits.get("memory"):
        container["mem_limit"] = size(limits["memory"])
    if limits.get("pids"):
        container["pids_limit"] = int(limits["pids"])
    if reserved.get("memory"):
        container["mem_reservation"] = size(reserved["memory"])
    if reserved.get("devices"):
        container["gpus"] = gpus(reserved["devices"])
    found: dict[str, Any] = {"cpu": float(reserved["cpus"])} if reserved.get("cpus") else {}
    return found | ({"memory": size(reserved["memory"])} if reserved.get("memory") else {}), container
