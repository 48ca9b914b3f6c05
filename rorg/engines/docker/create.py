"""Making a container: what one call of create cannot say to an older engine, or only the engine knows."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import docker
from docker.errors import APIError, ImageNotFound
from docker.utils import version_lt

from rorg.engines.docker.body import create_body
from rorg.engines.docker.volumes import keep_volumes

SEVERAL_NETWORKS = "1.44"
"""Version of the API whose create takes more than one network."""


def create_container(
    api: docker.APIClient,
    name: str,
    spec: Mapping[str, Any],
    labels: Mapping[str, str],
    before: str,
    defaults: Collection[str],
) -> str:
    """Makes a container and returns its id. It gets the unnamed volumes of `before`. Of `defaults`, what its image says
    itself is left to the image."""
    body, image = create_body(spec, labels), _image_config(api, spec["image"])
    if "stop_signal" in defaults and image.get("StopSignal"):
        body.pop("StopSignal", None)
    keep_volumes(api, body, image.get("Volumes") or {}, before)
    later = _networks_for_later(api, body)
    made = str(api.create_container_from_config(body, name, spec.get("platform"))["Id"])
    try:
        for network, endpoint in later.items():
            post(api, "/networks/{0}/connect", network, {"Container": made, "EndpointConfig": endpoint})
    except APIError:
        api.remove_container(made, v=True)
        raise
    return made


def post(api: Any, path: str, name: str, body: Mapping[str, Any]) -> None:
    """A call to the engine that its client library has no method for, or one that knows less than the engine."""
    api._raise_for_status(api._post_json(api._url(path, name), data=body))


def _image_config(api: docker.APIClient, image: str) -> Mapping[str, Any]:
    try:
        return api.inspect_image(image).get("Config") or {}
    except ImageNotFound:
        return {}  # create says so


def _networks_for_later(api: docker.APIClient, body: dict[str, Any]) -> dict[str, Any]:
    """Takes from the body the networks that must be joined after create: all but the first, with an older engine."""
    endpoints = body.get("NetworkingConfig", {}).get("EndpointsConfig", {})
    if not version_lt(api.api_version, SEVERAL_NETWORKS):
        return {}
    return {network: endpoints.pop(network) for network in sorted(endpoints)[1:]}
