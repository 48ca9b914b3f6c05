"""An engine's answers about itself, for checks of manifests and of the installation."""

from __future__ import annotations

from dataclasses import dataclass
from http.client import HTTPException
from typing import Any

from rorg.engines.docker.client import Client
from rorg.engines.docker.connect import engine_host
from rorg.engines.docker.errors import NoAnswer, reason
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
    version: str = ""
    runtimes: frozenset[str] = frozenset()
    cgroup: str = ""
    root: str = ""
    """The directory of its images and containers."""
    live_restore: bool = False
    """Containers keep running while the engine itself restarts."""


def engine_facts(host: str | None = None) -> EngineFacts:
    """Ask the engine at `host` (by default DOCKER_HOST, or Docker's own address) once."""
    where = engine_host(host)
    client = Client(where.removeprefix("http+"))
    try:
        info: dict[str, Any] = client.get("/info", timeout=PATIENCE)
    except (OSError, HTTPException, EngineError, ValueError) as error:
        why = error.why if isinstance(error, NoAnswer) else reason(error)
        return EngineFacts(where, why, denied=isinstance(error.__cause__, PermissionError))
    finally:
        client.close()
    return EngineFacts(
        where,
        version=str(info.get("ServerVersion") or ""),
        runtimes=frozenset(info.get("Runtimes") or {}),
        cgroup=str(info.get("CgroupVersion") or ""),
        root=str(info.get("DockerRootDir") or ""),
        live_restore=bool(info.get("LiveRestoreEnabled")),
    )
