"""Everything about a service: its declaration and where that comes from, its state, its last events and log lines."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fastapi import FastAPI
from fastapi.responses import Response

from rorg.api.callers import needs
from rorg.api.current import Current
from rorg.api.models import Description
from rorg.api.operations import Operations
from rorg.core.observed import Observed
from rorg.engines.protocol import Engine
from rorg.errors import RorgError
from rorg.history.journal import Filter, Journal
from rorg.manifest.effective import effective

MOST = 10
"""Events, and log lines."""
LONGEST = 1000
"""Bytes of a log line; longer ones are cut."""


def describe(
    current: Current, name: str, journal: Journal, engine: Callable[[], Engine], root: Path, robot: str
) -> list[dict[str, Any]]:
    """Describes a service, or each of a group. Asks the engine for the last lines of logs, and the tree of manifests at
    `root` for what declares each value. Raises Missing."""
    names = (name,) if name in current.statuses else current.members(name)
    services = current.catalog.services
    return [
        {
            **declared(current, n),
            "sources": _sources(root, n, robot) or {f"container.{k}": v for k, v in services[n].origins.items()},
            "events": [f"{e['at']} {e['message']}" for e in _events(journal, n)],
            "log": _log(current.decision.situation.observed, n, engine),
        }
        for n in names
    ]


def _sources(root: Path, name: str, robot: str) -> dict[str, str]:
    """Return field -> what declares it, as `rorg explain NAME` says; empty if the tree has mistakes now."""
    try:
        return {value.field: value.source for value in effective(root, name, robot)}
    except (RorgError, OSError):
        return {}


def _events(journal: Journal, service: str) -> list[dict[str, Any]]:
    return journal.select(Filter(services=frozenset({service})), MOST, newest=True)


def declared(current: Current, name: str) -> dict[str, Any]:
    """A service as its manifest declares it, with its status; of its environment only the names."""
    services, status = current.catalog.services, current.statuses[name]
    service = services[name]
    spec = {k: v for k, v in service.options.items() if k != "environment"}
    spec["environment"] = sorted(service.options.get("environment", {}))
    return {
        "name": name,
        "message": status.trouble,
        "description": service.description,
        "labels": dict(service.labels),
        "manifest": str(service.where),
        "needs": list(service.needs),
        "conflicts": list(service.conflicts),
        "always_on": service.always_on,
        "idle": {"action": service.idle.action, "linger": service.idle.linger, "connected": service.idle.connected},
        "restart": service.restart,
        "priority": service.priority,
        "driver": service.driver,
        "needed_by": sorted(s.name for s in services.values() if name in s.needs),
        "status": status.as_json(),
        "container": spec,
    }


def _log(observed: Observed, service: str, engine: Callable[[], Engine]) -> list[str]:
    """The last lines of the container that counts, or why they cannot be read."""
    containers = observed.by_service().get(service)
    if not containers:
        return []
    if observed.silence:
        return [str(observed.silence)]
    try:
        said = b"".join(line.text for line in engine().log_lines(containers[0].id, MOST, None, False))
    except RorgError as error:
        return [str(error)]
    return [line[:LONGEST].decode(errors="replace") for line in said.split(b"\n") if line][-MOST:]


def add_description(app: FastAPI, operations: Operations) -> None:
    """Adds the route."""

    @app.get("/v1/services/{name}/description", dependencies=[needs("logs")], response_model=list[Description])
    def description(name: str) -> Response:
        """Everything about a service, or each of a group: its declaration and where that comes from, its state, its
        last events and the last lines of its log. Of environments only the names."""
        descriptions = describe(
            operations.current,
            name,
            operations.journal,
            lambda: operations.engine,
            operations.tree.root,
            operations.tree.robot,
        )
        return Response(json.dumps(descriptions), media_type="application/json")
