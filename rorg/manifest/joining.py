"""Services whose containers use a namespace or the volumes of another service's container."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from typing import Any

from rorg.manifest.documents import Source
from rorg.model.catalog import Group, Service
from rorg.model.diagnostics import Diagnostic, Reading, Where, nearest
from rorg.model.joining import VOLUMES, ends_with, named

NOT_SHARED = ("", "private", "none")
NOWHERE = Where("")


def join(
    source: Source,
    service: Service,
    services: Mapping[str, Service],
    groups: Mapping[str, Group],
    known: Collection[str],
) -> Reading[Service]:
    """Adds the services that it joins to its needs, and to what restarts it if their end also ends the namespace: a
    container in a network that is gone is unreachable. `known` are all declared names, including broken ones."""
    joins: dict[str, tuple[str, ...]] = {}
    for option, index, name in named(service.options):
        diagnostic = _wrong(service, option, name, services, groups, known)
        if diagnostic:
            yield replace(diagnostic, where=place_of(source, option, index))
        elif name in services:
            joins[name] = tuple(dict.fromkeys((*joins.get(name, ()), option)))
    if not joins:
        return service
    needs = tuple(dict.fromkeys((*service.needs, *joins)))
    follows = tuple(sorted({*service.restarts_with, *ends_with(joins)}))
    return replace(service, needs=needs, restarts_with=follows, joins=joins)


def _wrong(
    service: Service,
    option: str,
    name: str,
    services: Mapping[str, Service],
    groups: Mapping[str, Group],
    known: Collection[str],
) -> Diagnostic | None:
    """The mistake in one joined service; the caller adds the place."""
    containers = [n for n, s in services.items() if not s.meta and n != service.name]
    if name == service.name:
        return Diagnostic(NOWHERE, f"{option}: '{name}' is this service itself", "another service")
    if name in groups:
        return Diagnostic(NOWHERE, f"{option}: '{name}' is a group, and has no container", "one of its members")
    if name in services:
        meta = services[name].meta
        return Diagnostic(NOWHERE, f"{option}: the meta-service '{name}' has no container", "another") if meta else None
    if name in known:
        return None  # its own mistakes are reported
    if option == VOLUMES:
        near = f"; {suggestion} for a service" if (suggestion := nearest(name, containers)).startswith("'") else ""
        message = f"{option}: no service '{name}', so this is the name of a container"
        return Diagnostic(NOWHERE, message, f"container:{name} to say so{near}", "warning")
    remedy = nearest(name, containers) or f"container:{name} for one that is not of this tree"
    return Diagnostic(NOWHERE, f"{option}: unknown service '{name}'", remedy)


def place_of(source: Source, option: str, index: int | None = None) -> Where:
    """The place of an option in the manifest, or of the name of the profile that declares it."""
    spec: Any = source.spec
    own = getattr(spec.container, option, None) if spec.container else None
    if own is None or (index is not None and index >= len(own)):
        return source.where("spec", "profile")
    return source.where("spec", "container", option, *(() if index is None else (index,)))


def told_of_processes(services: Mapping[str, Service], sources: Mapping[str, Source]) -> Iterator[Diagnostic]:
    """On the process engine, `volumes_from` does nothing. Network, shared memory and processes are the machine's for
    every process, so joining these works anyway."""
    for name, source in sources.items():
        for other in (n for n, options in services[name].joins.items() if VOLUMES in options):
            message = f"the process engine mounts nothing, so {VOLUMES} '{other}' brings nothing along"
            yield Diagnostic(place_of(source, VOLUMES), message, "paths of this machine", "warning")


def check_shared_memory(services: Mapping[str, Service], sources: Mapping[str, Source]) -> Iterator[Diagnostic]:
    """By default, an engine gives each container shared memory that no other may join; Docker refuses to start the
    other container ("non-shareable IPC")."""
    for name, source in sources.items():
        for other, options in services[name].joins.items():
            mode = str(services[other].options.get("ipc") or "")
            if "ipc" in options and mode in NOT_SHARED and other in sources:
                said = f"ipc: {mode}" if mode else "no ipc"
                message = f"ipc: '{other}' declares {said}, so its shared memory is its own"
                yield Diagnostic(place_of(source, "ipc"), message, f"ipc: shareable in {other}")
