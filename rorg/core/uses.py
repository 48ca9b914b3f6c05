"""Which services use which networks and volumes of their tree."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rorg.model.catalog import Catalog, Spec
from rorg.model.objects import EngineObject, subject
from rorg.model.volumes import is_path

Uses = Mapping[str, tuple[str, ...]]


def used_objects(catalog: Catalog) -> tuple[Mapping[str, EngineObject], Uses, Uses]:
    """By subject, networks and volumes that are declared; service -> those that it uses; the same the other way round.
    What no manifest declares is not among them: the engine has it, or makes it by itself."""
    objects = {one.subject: one for one in (*catalog.networks.values(), *catalog.volumes.values())}
    if not objects:
        return {}, {}, {}
    by_key = {one.key: name for name, one in objects.items()}
    uses, users = dict[str, tuple[str, ...]](), dict[str, list[str]]()
    for name, service in catalog.services.items():
        found = dict.fromkeys(by_key[key] for key in keys_of(service.spec or {}) if key in by_key)
        if found:
            uses[name] = tuple(found)
        for one in found:
            users.setdefault(one, []).append(name)
    return objects, uses, {one: tuple(sorted(names)) for one, names in users.items()}


def keys_of(spec: Spec) -> Iterator[str]:
    """All networks and named volumes that a container of this spec uses, declared or not."""
    for name in spec.get("networks") or ():
        yield subject("network", name)
    if spec.get("network_mode"):
        yield subject("network", str(spec["network_mode"]))
    for volume in spec.get("volumes") or ():
        if name := _named(volume):
            yield subject("volume", name)


def _named(volume: Any) -> str:
    """The name of a volume; empty for a path of the host, and for one without a name."""
    if isinstance(volume, Mapping):
        return str(volume.get("source") or "") if volume.get("type") == "volume" else ""
    source, colon, _ = volume.partition(":")
    return source if colon and not is_path(source) else ""
