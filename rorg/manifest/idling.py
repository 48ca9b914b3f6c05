"""Services that must not be paused, since others would hang on them."""

from __future__ import annotations

from collections.abc import Mapping

from rorg.manifest.documents import Source
from rorg.model.catalog import Service
from rorg.model.diagnostics import Diagnostic

INFRASTRUCTURE = {
    "roscore": "the ROS master",
    "rosmaster": "the ROS master",
    "fast-discovery-server": "a discovery server",
    "fastdds": "a discovery server",
    "rmw_zenohd": "a router",
    "zenohd": "a router",
    "rosbridge_websocket": "a bridge",
    "rorg_ros": "rorg's own bridge",
    "mosquitto": "a message broker",
}
"""Programs that all others talk to, by the name of their command. A call to one that is paused does not fail: it hangs
until it is resumed."""


def check_idling(services: Mapping[str, Service], sources: Mapping[str, Source]) -> list[Diagnostic]:
    """Infrastructure that would be paused when nobody requests it."""
    diagnostics = []
    for name, source in sources.items():
        service = services[name]
        words = [*(service.spec or {}).get("entrypoint", []), *(service.spec or {}).get("command", [])]
        what = next((INFRASTRUCTURE[w] for word in words if (w := word.rpartition("/")[2]) in INFRASTRUCTURE), None)
        if what and service.idle.action == "pause":
            diagnostics.append(
                Diagnostic(
                    source.where("spec", "idle", "action"),
                    f"'{name}' would be paused when idle, but it is {what}: all that talk to it would hang",
                    "idle: {action: stop}",
                    code="pause-of-infrastructure",
                )
            )
    return diagnostics
