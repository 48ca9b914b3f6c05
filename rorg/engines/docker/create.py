"""Makes a container: the parts that one create call cannot tell an older engine, or that only the engine knows. Names
the owner of a container, network or volume that is not ours."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from rorg.core.observed import LABEL_OWNER, LABEL_STATE
from rorg.engines.docker.body import Body, create_body
from rorg.engines.docker.client import Client
from rorg.engines.docker.errors import Refused, docker_errors
from rorg.engines.docker.release import LOCAL
from rorg.engines.docker.volumes import keep_volumes
from rorg.errors import EngineError, RorgError

SEVERAL_NETWORKS = (1, 44)
"""First version of the API whose create call takes more than one network."""


def create_container(
    client: Client,
    name: str,
    spec: Mapping[str, Any],
    labels: Mapping[str, str],
    before: str,
    defaults: Collection[str],
) -> str:
    """Make a container and return its id. It takes over the unnamed volumes of `before`. An option in `defaults` is
    left out if the image has its own value."""
    body, inspection = create_body(spec, labels), client.find(f"/images/{spec['image']}/json")
    if client.release.podman:
        inspection = inspection or _made_here(client, body)
        _without_init(body)
    image = (inspection or {}).get("Config") or {}  # create reports a missing image
    if "stop_signal" in defaults and image.get("StopSignal"):
        body.pop("StopSignal", None)
    keep_volumes(client, body, image.get("Volumes") or {}, before)
    return make(client, name, body, spec.get("platform"))


def _made_here(client: Client, body: Body) -> Any:
    """Podman's own command gives images without a registry this prefix, and the API looks for them at Docker Hub's."""
    inspection = client.find(f"/images/{LOCAL}{body['Image']}/json")
    if inspection:
        body["Image"] = f"{LOCAL}{body['Image']}"
    return inspection


def _without_init(body: Body) -> None:
    """Podman refuses `init` for a container with the processes of the host or of another container, where it would not
    be PID 1. Docker starts it, and it does little there."""
    if body["HostConfig"].get("PidMode"):
        body["HostConfig"].pop("Init", None)


def make(client: Client, name: str, body: Body, platform: str | None) -> str:
    """Make a container from a complete body and return its id."""
    later = _networks_for_later(client, body)
    made = str(client.post("/containers/create", body, name=name, platform=platform)["Id"])
    try:
        for network, endpoint in later.items():
            client.post(f"/networks/{network}/connect", {"Container": made, "EndpointConfig": endpoint})
    except Refused:
        client.delete(f"/containers/{made}", v=True)
        raise
    return made


def _networks_for_later(client: Client, body: dict[str, Any]) -> dict[str, Any]:
    """Take from the body the networks that must be joined after the create call: with an older engine, all except the
    first."""
    endpoints = body.get("NetworkingConfig", {}).get("EndpointsConfig", {})
    if client.release.api >= SEVERAL_NETWORKS:
        return {}
    return {network: endpoints.pop(network) for network in sorted(endpoints)[1:]}


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
