"""What manifests say of each other: groups, cycles in `needs`, conflicts that can never be served."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from graphlib import TopologicalSorter

from rorg.manifest.documents import Source
from rorg.manifest.joining import place_of
from rorg.model.catalog import DEVELOPER, Catalog, Group, Service
from rorg.model.diagnostics import Diagnostic, Where, nearest
from rorg.model.graph import closure, conflicting, cycles, overbooked


def expand_groups(
    sources: Mapping[str, Source], services: Mapping[str, Service], broken: set[str]
) -> tuple[dict[str, Group], list[Diagnostic]]:
    """Groups with their members as services; unknown members and groups in a ring are errors."""
    diagnostics: list[Diagnostic] = []
    graph: dict[str, list[str]] = {}
    for name, source in sources.items():
        graph[name] = []
        for index, member in enumerate(source.spec.services):
            if member in sources:
                graph[name].append(member)
            elif member not in services and member not in broken:
                where = source.where("spec", "services", index)
                known = {*services, *sources}
                diagnostics.append(Diagnostic(where, f"unknown service '{member}'", nearest(member, known)))
    rings = cycles(graph)
    for cycle in rings:
        source = sources[cycle[0]]
        index = list(source.spec.services).index(cycle[1])
        where, what = source.where("spec", "services", index), f"groups contain each other: {' -> '.join(cycle)}"
        diagnostics.append(Diagnostic(where, what, "breaking the cycle"))
    if rings:
        return {}, diagnostics
    groups: dict[str, Group] = {}
    for name in TopologicalSorter(graph).static_order():
        members: list[str] = []
        for member in sources[name].spec.services:
            members += groups[member].services if member in groups else [member] if member in services else []
        groups[name] = Group(
            name, tuple(dict.fromkeys(members)), sources[name].description, sources[name].where("metadata", "name")
        )
    return groups, diagnostics


def check_cycles(services: Mapping[str, Service], sources: Mapping[str, Source]) -> list[Diagnostic]:
    """A service that needs itself, through others or directly, can never start."""
    diagnostics = []
    for cycle in cycles({s.name: s.needs for s in services.values()}):
        source = sources[cycle[0]]
        written = [n.service for n in source.spec.needs]
        joined = services[cycle[0]].joins.get(cycle[1])
        if cycle[1] in written:
            where = source.where("spec", "needs", written.index(cycle[1]))
        else:
            where = place_of(source, joined[0]) if joined else source.where("spec")
        what = f"services need each other: {' -> '.join(cycle)}"
        diagnostics.append(Diagnostic(where, what, "dropping one of these needs"))
    return diagnostics


def check_conflicts(catalog: Catalog, sources: Mapping[str, Source]) -> list[Diagnostic]:
    """Services that would have to be active together and must not: one service's needs, all that is always on, or what
    standing requests add to that."""
    roots = [s.name for s in catalog.services.values() if s.always_on]
    diagnostics = _conflicting_needs(catalog, sources)
    for a, b in conflicting(catalog.services, closure(catalog.services, roots)):
        source = sources[a if catalog.services[a].always_on else b]
        diagnostics.append(
            Diagnostic(_place(source, "always_on"), f"'{a}' and '{b}' conflict and are both always on", "dropping one")
        )
    return diagnostics + _conflicting_requests(catalog, roots)


def _conflicting_needs(catalog: Catalog, sources: Mapping[str, Source]) -> list[Diagnostic]:
    diagnostics = []
    for name in sorted(catalog.services):
        for a, b in conflicting(catalog.services, closure(catalog.services, [name])):
            diagnostics.append(
                Diagnostic(
                    _place(sources[name], "needs"),
                    f"'{name}' needs both '{a}' and '{b}', which conflict",
                    "dropping one",
                )
            )
        needs = catalog.services[name].needs
        if any(overbooked(catalog, closure(catalog.services, [n])) for n in needs):
            continue  # it is said there
        for found in overbooked(catalog, closure(catalog.services, [name])):
            diagnostics.append(
                Diagnostic(
                    _place(sources[name], "needs" if needs else "exclusive"),
                    f"'{name}' can never be active: {found}",
                    "fewer units, or `resources` in the Policy",
                )
            )
    return diagnostics


def _conflicting_requests(catalog: Catalog, always_on: list[str]) -> list[Diagnostic]:
    """One standing request after the other, each on top of those that count as long as rorg runs."""
    diagnostics, roots = [], list(always_on)
    for request in catalog.requests:
        before = closure(catalog.services, roots)
        if catalog.services[request.requester].meta:
            roots += [m for s in request.services for m in catalog.members(s)]
        names = before | closure(catalog.services, [m for s in request.services for m in catalog.members(s)])
        for a, b in sorted(set(conflicting(catalog.services, names)) - set(conflicting(catalog.services, before))):
            diagnostics.append(
                Diagnostic(
                    request.where,
                    f"with this request both '{a}' and '{b}' would be wanted, which conflict",
                    "dropping one",
                )
            )
    return diagnostics


def _place(source: Source, field: str) -> Where:
    return source.where("spec", field, key=True)


def check_spelling(sources: Iterable[Source]) -> list[Diagnostic]:
    """Names of one kind that differ by case alone: files of the same name to some file systems, and to people. A
    service and a group are of one kind here, since a request names either."""
    first: dict[tuple[str, str], tuple[str, str]] = {("Service", DEVELOPER): (DEVELOPER, "built in")}
    diagnostics = []
    for source in sources:
        kind = "Service" if source.kind == "Group" else source.kind
        where = source.where("metadata", "name")
        name, place = first.setdefault((kind, source.name.lower()), (source.name, f"at {where}"))
        if name != source.name:
            message = f"the name '{source.name}' differs only by case from '{name}', which is {place}"
            diagnostics.append(Diagnostic(where, message, "another name"))
    return diagnostics


def check_container_names(services: Mapping[str, Service], sources: Mapping[str, Source]) -> list[Diagnostic]:
    """Two services can have no container of the same name, and the engine wants two letters at the least."""
    owners: dict[str, str] = {}
    diagnostics = []
    for name in sources:
        service = services[name]
        if len(service.container_name) < 2 and not service.meta:
            message = f"a container cannot be called '{service.container_name}': a name has two letters at the least"
            diagnostics.append(Diagnostic(sources[name].where("metadata", "name"), message, "container.container_name"))
        first = owners.setdefault(service.container_name, name)
        if first != name:
            both = sorted((first, name), key=lambda n: services[n].container_name == n)
            where = sources[both[0]].where("spec", "container", "container_name")
            diagnostics.append(
                Diagnostic(
                    where,
                    f"the container of '{both[1]}' is called '{service.container_name}' too",
                    "another container_name",
                )
            )
    return diagnostics
