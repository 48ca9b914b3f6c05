"""The engine's inspection of a container, as a Container; and its live options, which an update changes in place."""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import datetime
from typing import Any

from rorg.core.observed import Container, from_labels
from rorg.engines.docker.body import NANO, Body, create_body
from rorg.host.clock import process_start
from rorg.model.options import LIVE, OPTIONS

ENGINES_OWN = ("bridge", "host", "none")
"""Networks that every engine has."""
STATES: Mapping[str, str] = {
    "configured": "created",
    "initialized": "created",
    "stopping": "running",
    "stopped": "exited",
}
"""Podman's states -> Docker's, where they differ. A container is `stopped` from the end of its program until Podman has
cleaned up after it, and cannot be told from one that has exited."""
NEVER = "0001-01-01T00:00:00Z"
"""The engine's start time of a container that never started."""
SLOW_START = 10.0
"""Seconds that the engine may take to note a start, on a busy machine."""
EARLY = 1.0
"""Seconds of output before the engine's time of the start that are read if the process cannot say when it began: more
would be output of the run before."""
_LIVE = {name: OPTIONS[name].api.removeprefix("HostConfig.") for name in LIVE - {"container_name"}}


def epoch_seconds(stamp: str) -> float:
    """The engine's times have nine digits after the second; Python reads six."""
    return datetime.fromisoformat(
        re.sub(r"(\.\d{1,6})\d*Z?$", r"\1+00:00", stamp.rstrip("Z") + "Z").replace("Z", "+00:00")
    ).timestamp()


def began(container: Container) -> float:
    """Return when its current run began, by the clock of then, as in the times of its log.

    The engine notes the start after the program's first output; the process knows it, but by the present clock. If the
    two are far apart, the clock was set since, and only the engine's time fits the log.
    """
    noted = epoch_seconds(container.started_at)
    try:
        start = process_start(container.pid)
    except (OSError, IndexError, ValueError):
        return noted
    return start if 0.0 <= noted - start <= SLOW_START else noted - EARLY


def read_container(data: Mapping[str, Any], local: bool) -> Container:
    """A Container from its inspection. If the engine is on another machine (`local` is false), process ids mean nothing
    here. Raises TypeError and the like if the data has another form than Docker's API says."""
    state, labels = data["State"], data["Config"].get("Labels") or {}
    status = state_of(_text(state["Status"]))
    started = _text(state.get("StartedAt") or NEVER)
    return Container(
        id=_text(data["Id"]),
        name=data["Name"].lstrip("/"),
        state=status,
        started_at="" if started.startswith("0001-") else started,
        exit_code=state.get("ExitCode") if status == "exited" else None,
        oom_killed=bool(state.get("OOMKilled")),
        error=state.get("Error") or "",
        created_at=_text(data.get("Created") or ""),
        live=live_options(data.get("HostConfig") or {}),
        pid=(state.get("Pid") or 0) if local else 0,
        health=(state.get("Health") or {}).get("Status", ""),
        stop_signal=data["Config"].get("StopSignal") or "",
        image=_text(data.get("Image") or ""),
        networks=_networks(data),
        **from_labels(labels),
    )


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{str(value)[:100]!r} is not a text")
    return value


def state_of(status: str) -> str:
    """A state in Docker's words."""
    return STATES.get(status, status)


def _networks(data: Mapping[str, Any]) -> dict[str, str]:
    """By name, the ids of the networks that it joins; the engine's own are left out, since they never change. Podman
    joins networks by name, and says the name again where Docker has the id: then the id does not matter."""
    networks = (data.get("NetworkSettings") or {}).get("Networks") or {}
    ids = {name: (n or {}).get("NetworkID") or "" for name, n in networks.items() if name not in ENGINES_OWN}
    return {name: "" if number == name else number for name, number in ids.items()}


def live_options(host: Mapping[str, Any]) -> dict[str, Any]:
    """Live options of a container, from the HostConfig of its inspection, in the units of manifests."""
    options = {option: host[key] for option, key in _LIVE.items() if key in host}
    options["cpus"] = (host.get("NanoCpus") or 0) / NANO
    options["pids_limit"] = host.get("PidsLimit")  # None if it was never in force
    policy = host.get("RestartPolicy") or {}
    count = policy.get("MaximumRetryCount") or 0
    options["restart"] = (policy.get("Name") or "no") + (f":{count}" if count else "")
    return options


def update_body(options: Mapping[str, Any]) -> Body:
    """The body of POST /containers/ID/update. A memory limit also moves the limit of memory and swap together, as
    create does: the engine refuses a limit above the old one of both."""
    body: Body = create_body(options, {})["HostConfig"]
    if "Memory" in body and "MemorySwap" not in body:
        body["MemorySwap"] = 2 * body["Memory"] or -1
    return body
