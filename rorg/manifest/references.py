"""References between manifests: names that must exist, groups, cycles in `needs`, unsolvable conflicts.

Names are checked once all manifests are read, because any file may name any other.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from graphlib import TopologicalSorter
from typing import Any

from rorg.manifest.documents import Source
from rorg.manifest.joining import place_of
from rorg.manifest.profiles import COMMON
from rorg.model.catalog import DEVELOPER, EVERY, Catalog, Group, Request, Service
from rorg.model.diagnostics import Diagnostic, Reading, Where, nearest, unknown
from rorg.model.graph import closure, conflicting, cycles, overbooked

Sources = Mapping[str, Source]
"""Manifests of one kind by name."""


def resolve(
    source: Source, service: Service, services: Mapping[str, Service], groups: Mapping[str, Group], broken: set[str]
) -> Reading[Service]:
    """The service with groups in `needs` and `conflicts` replaced by their members; unknown names are errors."""
    known = {*services, *groups}
    resolved: dict[str, tuple[str, ...]] = {}
    for field in ("needs", "conflicts"):
        names: list[str] = []
        written = [getattr(n, "service", n) for n in getattr(source.spec, field)]
        for name in getattr(service, field):
            own = name in written
            where = source.where("spec", field, written.index(name)) if own else source.where("spec", "profile")
            if field == "conflicts" and (name == service.name or name in service.needs):
                what = "itself" if name == service.name else f"'{name}', which it needs"
                yield Diagnostic(where, f"'{service.name}' conflicts with {what}", "to drop one of them")
            elif name not in known and name not in broken:
                by = "" if own else f" (by profile '{', '.join(source.spec.profile or [COMMON])}')"
                yield Diagnostic(where, f"{field} unknown service '{name}'{by}", nearest(name, known - {service.name}))
            names += [m for m in groups[name].services if m != service.name] if name in groups else [name]
        resolved[field] = tuple(dict.fromkeys(names))
    follows = {m for n in service.restarts_with for m in (groups[n].services if n in groups else [n])} - {service.name}
    needs, conflicts = resolved["needs"], resolved["conflicts"]
    return replace(service, needs=needs, conflicts=conflicts, restarts_with=tuple(sorted(follows)))


def unknown_profiles(source: Source, known: Collection[str], broken: set[str]) -> Iterator[Diagnostic]:
    """Profiles that a Service names and that do not exist."""
    for index, name in enumerate(source.spec.profile or ()):
        if name not in known and name not in broken:
            at = ("spec", "profile", index)
            where = source.where(*at) if at in source.document.values else source.where("spec", "profile")
            yield unknown(where, "profile", name, known)


def unknown_permitted(sources: Sources, known: set[str], broken: set[str]) -> Iterator[Diagnostic]:
    """Names that do not exist, in the fields that give a service permissions."""
    for source in sources.values():
        for field in ("may_request", "may_restart", "may_act_for"):
            for index, other in enumerate(getattr(source.spec, field)):
                if other not in known | broken and (field, other) != ("may_act_for", EVERY):
                    yield unknown(source.where("spec", field, index), "service", other, known)


def requests_of(
    sources: Sources, known: set[str], requesters: Collection[str], broken: set[str]
) -> Reading[tuple[Request, ...]]:
    """Standing requests, and the names in them that do not exist."""
    requests = []
    for name, source in sources.items():
        spec: Any = source.spec
        if spec.requester not in requesters and spec.requester not in broken:
            yield unknown(source.where("spec", "requester"), "requester", spec.requester, requesters)
        for index, service in enumerate(spec.services):
            if service not in known and service not in broken:
                yield unknown(source.where("spec", "services", index), "service", service, known)
        where, services = source.where("metadata", "name"), tuple(spec.services)
        request = Request(name, spec.requester, services, spec.reason or "", standing=True, priority=spec.priority)
        requests.append(replace(request, where=where))
    return tuple(requests)


def expand_groups(sources: Sources, services: Mapping[str, Service], broken: set[str]) -> Reading[dict[str, Group]]:
    """Groups with services as their members. Unknown members, and groups that contain each other, are errors."""
    graph: dict[str, list[str]] = {}
    for name, source in sources.items():
        graph[name] = []
        for index, member in enumerate(source.spec.services):
            if member in sources:
                graph[name].append(member)
            elif member not in services and member not in broken:
                yield unknown(source.where("spec", "services", index), "service", member, {*services, *sources})
    rings = cycles(graph)
    for cycle in rings:
        source = sources[cycle[0]]
        where = source.where("spec", "services", list(source.spec.services).index(cycle[1]))
        yield Diagnostic(where, f"groups contain each other: {' -> '.join(cycle)}", "to break the cycle")
    if rings:
        return {}
    groups: dict[str, Group] = {}
    for name in TopologicalSorter(graph).static_order():
        members: list[str] = []
        for member in sources[name].spec.services:
            members += groups[member].services if member in groups else [member] if member in services else []
        place = sources[name].where("metadata", "name")
        groups[name] = Group(name, tuple(dict.fromkeys(members)), sources[name].description, place)
    return groups


def check_cycles(services: Mapping[str, Service], sources: Sources) -> Iterator[Diagnostic]:
    """Services that need themselves, directly or through others: they can never start."""
    for cycle in cycles({s.name: s.needs for s in services.values()}):
        source = sources[cycle[0]]
        written = [n.service for n in source.spec.needs]
        joined = services[cycle[0]].joins.get(cycle[1])
        if cycle[1] in written:
            where = source.where("spec", "needs", written.index(cycle[1]))
        else:
            where = place_of(source, joined[0]) if joined else source.where("spec")
        yield Diagnostic(where, f"services need each other: {' -> '.join(cycle)}", "to drop one of these needs")


def check_conflicts(catalog: Catalog, sources: Sources, sure: bool) -> Iterator[Diagnostic]:
    """Services that conflict although one service needs both, both are always on, or standing requests name both.
    `sure`: the Policy is valid, so its resources are known."""
    yield from _conflicting_needs(catalog, sources, sure)
    roots = [s.name for s in catalog.services.values() if s.always_on]
    for a, b in conflicting(catalog.services, closure(catalog.services, roots)):
        where = _key(sources[a if catalog.services[a].always_on else b], "always_on")
        yield Diagnostic(where, f"'{a}' and '{b}' conflict and are both always on", "to drop one")
    yield from _conflicting_requests(catalog, roots)


def _conflicting_needs(catalog: Catalog, sources: Sources, sure: bool) -> Iterator[Diagnostic]:
    pairs = {name: conflicting(catalog.services, closure(catalog.services, [name])) for name in catalog.services}
    for name in sorted(catalog.services):
        below = {pair for need in catalog.services[name].needs for pair in pairs.get(need, ())}
        for a, b in (pair for pair in pairs[name] if pair not in below and name not in pair):
            message = f"'{name}' needs both '{a}' and '{b}', which conflict"
            yield Diagnostic(_key(sources[name], "needs"), message, "to drop one")
        if not sure:
            continue
        needs = catalog.services[name].needs
        if any(overbooked(catalog, closure(catalog.services, [n])) for n in needs):
            continue  # reported for that service
        for shortage in overbooked(catalog, closure(catalog.services, [name])):
            where = _key(sources[name], "needs" if needs else "exclusive")
            message = f"'{name}' can never be active: {shortage}"
            yield Diagnostic(where, message, "fewer units, or `resources` in the Policy")


def _conflicting_requests(catalog: Catalog, always_on: Iterable[str]) -> Iterator[Diagnostic]:
    """Adds one standing request after another to those whose requester is always active."""
    roots = list(always_on)
    for request in catalog.requests:
        before = closure(catalog.services, roots)
        named = [m for s in request.services for m in catalog.members(s)]
        requester = catalog.services.get(request.requester)
        if requester and requester.meta:
            roots += named
        names = before | closure(catalog.services, named)
        for a, b in sorted(set(conflicting(catalog.services, names)) - set(conflicting(catalog.services, before))):
            message = f"with this request both '{a}' and '{b}' would be wanted, which conflict"
            yield Diagnostic(request.where, message, "to drop one")


def _key(source: Source, field: str) -> Where:
    return source.where("spec", field, key=True)


def check_spelling(sources: Iterable[Source]) -> Iterator[Diagnostic]:
    """Names of one kind that differ only by case: some file systems, and people, take them for the same. Services and
    groups count as one kind, because a request may name either."""
    first: dict[tuple[str, str], tuple[str, str]] = {("Service", DEVELOPER): (DEVELOPER, "built in")}
    for source in sources:
        kind = "Service" if source.kind == "Group" else source.kind
        where = source.where("metadata", "name")
        name, place = first.setdefault((kind, source.name.lower()), (source.name, f"at {where}"))
        if name != source.name:
            message = f"the name '{source.name}' differs only by case from '{name}', which is {place}"
            yield Diagnostic(where, message, "another name")


def check_container_names(services: Mapping[str, Service], sources: Sources) -> Iterator[Diagnostic]:
    """Names of containers that are used twice, or are shorter than the two characters that the engine requires.

    Services that conflict need different names too: a stopped container keeps its name, and the engine then creates no
    other one of that name."""
    owners: dict[str, str] = {}
    for name in sources:
        called = services[name].container_name
        if len(called) < 2 and not services[name].meta:
            message = f"a container cannot be called '{called}': a name needs at least two characters"
            yield Diagnostic(sources[name].where("metadata", "name"), message, "container.container_name")
        first = owners.setdefault(called, name)
        if first != name:
            both = sorted((first, name), key=lambda n: services[n].container_name == n)
            where = sources[both[0]].where("spec", "container", "container_name")
            message = f"the container of '{both[1]}' is called '{called}' too, and keeps that name while it is stopped"
            yield Diagnostic(where, message, "another container_name")
