"""Keeps what the last good tree declared, so that the next rorg knows what has been removed from it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from rorg.model.catalog import Catalog, Group, Idle, Probe, Request, Service, Updating
from rorg.model.diagnostics import Where
from rorg.model.former import Former, Kept
from rorg.model.ros import RosParameters
from rorg.store.files import write_atomic
from rorg.store.state_dir import read_json

NAME = ".services.last-good.json"
T = TypeVar("T")


def write_kept(folder: Path, kept: Kept) -> None:
    """Only the owner may read the file: it has values of the environment."""
    if kept.catalog is None:
        return
    former = [
        {**_dump(f.what), "needed_by": f.needed_by, "groups": f.groups, "withheld": f.withheld}
        for f in kept.former.values()
    ]
    declared: list[Service | Group] = [*kept.catalog.services.values(), *kept.catalog.groups.values()]
    last = [_dump(what) for what in declared]
    content = {"last": last, "former": former, "requests": [asdict(r) for r in kept.catalog.requests]}
    write_atomic(folder / NAME, json.dumps({"digest": _digest(content), **content}) + "\n", mode=0o600)


def read_kept(folder: Path) -> Kept:
    """The last written content; nothing if the file was damaged. Entries that this version does not understand are
    ignored."""
    try:
        content = read_json(folder / NAME) or {}
        if content.pop("digest", "") != _digest(content):
            return Kept()
        last, former = _each(content["last"], _load), _each(content["former"], _former)
        requests = _each(content.get("requests", []), _request)
    except (ValueError, LookupError, TypeError, RecursionError):
        return Kept()
    services = {w.name: w for w in last if isinstance(w, Service)}
    groups = {w.name: w for w in last if isinstance(w, Group)}
    return Kept(Catalog(services, groups, requests=tuple(requests)), {f.what.name: f for f in former})


def _digest(content: Mapping[str, Any]) -> str:
    """Detects damage anywhere in the file."""
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


def _dump(what: Service | Group) -> dict[str, Any]:
    return {"service" if isinstance(what, Service) else "group": asdict(what)}


def _each(entries: Iterable[Any], read: Callable[[Any], T]) -> list[T]:
    found = []
    for entry in entries:
        try:
            found.append(read(entry))
        except (TypeError, LookupError, AttributeError, ValueError):
            continue
    return found


def _former(entry: Mapping[str, Any]) -> Former:
    return Former(_load(entry), tuple(entry["needed_by"]), tuple(entry["groups"]), str(entry["withheld"]))


def _request(entry: Mapping[str, Any]) -> Request:
    return Request(**{**entry, "services": tuple(entry["services"]), "where": Where(**entry["where"])})


def _load(entry: Mapping[str, Any]) -> Service | Group:
    data = entry.get("service") or entry["group"]
    flat: dict[str, Any] = {
        **{k: tuple(v) if isinstance(v, list) else v for k, v in data.items()},
        "where": Where(**data["where"]),
    }
    if "service" not in entry:
        return Group(**flat)
    idle = data["idle"]
    flat["idle"] = Idle(**{**idle, "escalate": tuple(idle["escalate"]) if idle["escalate"] else None})
    flat["update"] = Updating(**data.get("update", {}))
    flat["joins"] = {name: tuple(options) for name, options in data.get("joins", {}).items()}
    flat["ros"] = RosParameters(**data["ros"]) if data.get("ros") else None
    for role in ("ready", "live", "interlock"):
        flat[role] = _probe(data[role])
    return Service(**flat)


def _probe(data: Mapping[str, Any] | None) -> Probe | None:
    if data is None:
        return None
    target, parts = data["target"], tuple(filter(None, map(_probe, data.get("parts", ()))))
    return Probe(**{**data, "target": tuple(target) if isinstance(target, list) else target, "parts": parts})
