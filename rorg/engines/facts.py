"""An engine's answers about itself, for checks of manifests and of the installation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from http.client import HTTPException
from typing import Any

from rorg.engines.docker.client import Client
from rorg.engines.docker.connect import engine_host
from rorg.engines.docker.errors import NoAnswer, Refused, reason
from rorg.engines.docker.lacking import capabilities, lacking
from rorg.errors import EngineError

PATIENCE = 5.0
"""Seconds for its answer."""


@dataclass(frozen=True, slots=True)
class EngineFacts:
    """`error` says why nothing is known; empty if the engine answered."""

    host: str
    error: str = ""
    denied: bool = False
    """The engine is there, but this user may not use it."""
    product: str = "Docker"
    version: str = ""
    runtimes: frozenset[str] = frozenset()
    cgroup: str = ""
    root: str = ""
    """The directory of its images and containers."""
    live_restore: bool = False
    """Containers keep running while the engine itself restarts."""
    pauses: bool = True
    lacking: Mapping[str, str] = field(default_factory=dict)
    """Option of a container -> what the engine does with it instead, and why."""


def engine_facts(host: str | None = None) -> EngineFacts:
    """Ask the engine at `host` (by default DOCKER_HOST, or Docker's own address) once."""
    where = engine_host(host)
    client = Client(where.removeprefix("http+"))
    try:
        info: dict[str, Any] = client.get("/info", timeout=PATIENCE)
        product, pauses, lacks = client.release.product, capabilities(client).pause, lacking(client, info)
    except (OSError, HTTPException, EngineError, ValueError, Refused) as error:
        why = error.why if isinstance(error, NoAnswer) else reason(error)
        return EngineFacts(where, why, denied=isinstance(error.__cause__, PermissionError))
    finally:
        client.close()
    return EngineFacts(
        where,
        product=product,
        version=str(info.get("ServerVersion") or ""),
        runtimes=frozenset(info.get("Runtimes") or {}),
        cgroup=str(info.get("CgroupVersion") or ""),
        root=str(info.get("DockerRootDir") or ""),
        live_restore=client.release.podman or bool(info.get("LiveRestoreEnabled")),
        pauses=pauses,
        lacking=lacks,
    )
