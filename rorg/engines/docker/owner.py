"""Names the owner of a container, network or volume that is not ours."""

from __future__ import annotations

from collections.abc import Mapping

from rorg.core.observed import LABEL_OWNER, LABEL_STATE
from rorg.engines.docker.client import Client
from rorg.engines.docker.errors import docker_errors
from rorg.errors import EngineError, RorgError


def other_rorg(labels: Mapping[str, str], owner: str) -> str:
    """Name the other rorg that made it, for people; empty if no other rorg did."""
    other = labels.get(LABEL_OWNER, owner)
    if other == owner:
        return ""
    state = labels.get(LABEL_STATE)
    return f"another rorg, whose state directory is {state}" if state else f"another rorg, with the owner id {other}"


def name_taken(client: Client, name: str, owner: str, error: EngineError) -> EngineError:
    """The same error; if the container of that name belongs to another rorg, it says to which."""
    try:
        with docker_errors(f"inspect {name}"):
            labels = client.get(f"/containers/{name}/json")["Config"].get("Labels") or {}
    except RorgError:
        return error
    other = other_rorg(labels, owner)
    if not other:
        return error
    state = labels.get(LABEL_STATE)
    down = f"`rorg down --state-dir {state}`" if state else "`rorg down` with that rorg's --state-dir"
    why = f"a container of that name belongs to {other}"
    return EngineError(error.what, why, f"{down}, or another container_name", error.kind)
