"""Networks and volumes of a tree, and the services that use them. Names in services are replaced by the engine's
names."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from typing import Any

from rorg.manifest.documents import Source
from rorg.manifest.programs import of_this_machine
from rorg.model.catalog import Service
from rorg.model.diagnostics import Diagnostic, Reading, close_to
from rorg.model.objects import EngineObject, Kind, keys_of

Objects = Mapping[str, EngineObject]
"""Objects of one kind, by the name that services write."""
ALIKE = 0.8
"""Similarity (of difflib) above which a name counts as misspelt."""
OWN = frozenset(("host", "none", "bridge", "default"))
"""Built-in networks of the engine."""
LEFT_OUT: Mapping[Kind, str] = {
    "network": "the process engine makes no networks: its services use those of this machine",
    "volume": "the process engine makes no volumes: its services use directories of this machine",
}
"""Their use if services are plain processes."""


def objects_of(kind: Kind, sources: Mapping[str, Source], engine: str) -> Reading[dict[str, EngineObject]]:
    """Returns all objects of one kind. Two with the same engine name are an error. If `engine` does not have them, one
    warning says so."""
    objects = {name: _object(kind, source) for name, source in sources.items()}
    owners: dict[str, str] = {}
    for name, one in objects.items():
        first = owners.setdefault(one.called, name)
        if first != name:
            where = sources[name].where("spec", "name") if one.called != name else sources[name].where("metadata")
            yield Diagnostic(where, f"the {kind} '{first}' is called '{one.called}' too", "another name")
    if objects and of_this_machine(engine):
        where = sources[min(objects)].where("kind")
        yield Diagnostic(where, LEFT_OUT[kind], "the docker engine, where that matters", "warning")
    return objects


def _object(kind: Kind, source: Source) -> EngineObject:
    spec: Any = source.spec
    return EngineObject(
        kind,
        source.name,
        spec.name or source.name,
        spec.model_dump(exclude_none=True, exclude={"name", "external"}),
        spec.external,
        source.description,
        source.labels,
        source.where("metadata", "name"),
    )


def joined(service: Service, networks: Objects, volumes: Objects) -> Service:
    """Replaces names of networks and volumes in a service by the engine's names; undeclared names stay."""
    spec = service.spec
    if spec is None or not (networks or volumes):
        return service
    replacements: dict[str, Any] = {}
    if networks and spec.get("networks"):
        replacements["networks"] = {_called(name, networks): options for name, options in spec["networks"].items()}
    if spec.get("network_mode") in networks:
        replacements["network_mode"] = _called(spec["network_mode"], networks)
    if volumes and spec.get("volumes"):
        replacements["volumes"] = [_mounted(volume, volumes) for volume in spec["volumes"]]
    changed = any(replacements[option] != spec[option] for option in replacements)
    return replace(service, spec={**spec, **replacements}) if changed else service


def _called(name: str, objects: Objects) -> str:
    return objects[name].called if name in objects else name


def _mounted(volume: Any, volumes: Objects) -> Any:
    if isinstance(volume, Mapping):
        named = volume["type"] == "volume" and volume.get("source") in volumes
        return {**volume, "source": _called(volume["source"], volumes)} if named else volume
    source, colon, rest = volume.partition(":")
    return _called(source, volumes) + colon + rest if colon else volume


def check_default(
    services: Mapping[str, Service], sources: Mapping[str, Source], networks: Collection[str]
) -> Iterator[Diagnostic]:
    """Refuses options for `default`, the engine's own network, unless a manifest declares a network of that name."""
    for name, source in sources.items():
        options = (services[name].options.get("networks") or {}).get("default")
        if options and any(options.values()) and "default" not in networks:
            where = source.where("spec", "container", "networks", "default")
            message = "'default' takes no options, and no Network declares it"
            yield Diagnostic(where, message, "networks/default.yaml, or the name of a network of your own")


def misspelt(
    services: Mapping[str, Service], sources: Mapping[str, Source], networks: Objects, volumes: Objects
) -> Iterator[Diagnostic]:
    """Warns about names that are almost those of a Network or Volume: the engine does not have such a network, and
    would create a new volume."""
    for name, source in sources.items():
        for key in keys_of(services[name].options):
            kind, _, called = key.partition("/")
            declared = networks if kind == "network" else volumes
            known = {*declared, *OWN, *(one.called for one in declared.values())}
            near = "" if called in known else close_to(called, known - OWN, ALIKE)
            if near:
                where = source.where("spec", "container", f"{kind}s")
                yield Diagnostic(where, f"no {kind.capitalize()} is called '{called}'", f"'{near}'", "warning")
