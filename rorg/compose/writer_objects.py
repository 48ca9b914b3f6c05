"""Networks and volumes of a robot as sections of a Compose file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from rorg.model.catalog import Service
from rorg.model.objects import EngineObject, Kind
from rorg.model.volumes import is_path

ENGINES_OWN = ("host", "none", "bridge", "default")
"""Networks that are always there."""


def sections(kind: Kind, declared: Mapping[str, EngineObject], services: Iterable[Service]) -> dict[str, Any]:
    """All that the tree declares, by the names that it writes, and all else that services name, by the engine's: a
    network must then be there, and a volume is made where it is not."""
    found = {name: _declared(one) for name, one in declared.items()}
    known = {one.called for one in declared.values()}
    named = _networks if kind == "network" else _volumes
    for name in sorted({name for service in services for name in named(service.spec or {})} - known):
        key = name if name not in found else f"{name}-external"
        found[key] = {"name": name, "external": True} if kind == "network" else {"name": name}
    return dict(sorted(found.items()))


def _declared(one: EngineObject) -> dict[str, Any]:
    return {"name": one.called, "external": True} if one.external else {"name": one.called, **one.spec}


def _networks(spec: Mapping[str, Any]) -> Iterator[str]:
    """A network_mode names one only where that is declared: else Compose takes it as it is."""
    yield from (name for name in spec.get("networks") or () if name not in ENGINES_OWN)


def _volumes(spec: Mapping[str, Any]) -> Iterator[str]:
    for value in spec.get("volumes", ()):
        if isinstance(value, Mapping):
            name = (value.get("source") or "") if value["type"] == "volume" else ""
        else:
            name = value.partition(":")[0] if ":" in value else ""
        if name and not is_path(name) and not name.startswith("$"):
            yield name
