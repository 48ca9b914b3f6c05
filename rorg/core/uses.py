"""Which services use which networks and volumes of their tree."""

from __future__ import annotations

from collections.abc import Mapping

from rorg.model.catalog import Catalog
from rorg.model.objects import EngineObject, keys_of

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
