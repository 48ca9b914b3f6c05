"""Options that an engine changes in place: as an inspection shows them, and as the body of an update."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rorg.engines.docker.body import NANO, Body, create_body
from rorg.model.options import LIVE, OPTIONS

_LIVE = {name: OPTIONS[name].api.removeprefix("HostConfig.") for name in LIVE - {"container_name"}}


def live_options(host: Mapping[str, Any]) -> dict[str, Any]:
    """Live options of a container, from the HostConfig of its inspection, in the units of manifests."""
    found = {option: host[key] for option, key in _LIVE.items() if key in host}
    found["cpus"] = (host.get("NanoCpus") or 0) / NANO
    found["pids_limit"] = host.get("PidsLimit")  # None if it was never in force
    policy = host.get("RestartPolicy") or {}
    count = policy.get("MaximumRetryCount") or 0
    found["restart"] = (policy.get("Name") or "no") + (f":{count}" if count else "")
    return found


def update_body(options: Mapping[str, Any]) -> Body:
    """The body of POST /containers/ID/update. A memory limit also moves the limit of memory and swap together, as
    create does: the engine refuses a limit above the old one of both."""
    body: Body = create_body(options, {})["HostConfig"]
    if "Memory" in body and "MemorySwap" not in body:
        body["MemorySwap"] = 2 * body["Memory"] or -1
    return body
