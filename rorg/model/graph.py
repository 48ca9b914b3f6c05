"""Graphs of services and images: needs and their cycles, conflicts, overbooked resources, bases of images."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from graphlib import CycleError, TopologicalSorter

from rorg.model.catalog import Catalog, Image, Service
from rorg.model.image_names import plain


def closure(services: Mapping[str, Service], names: Iterable[str]) -> set[str]:
    """The named services and everything that they need."""
    members: set[str] = set()
    pending = list(names)
    while pending:
        name = pending.pop()
        if name not in members and name in services:
            members.add(name)
            pending += services[name].needs
    return members


def cycles(graph: Mapping[str, Iterable[str]]) -> list[list[str]]:
    """Returns a shortest cycle through every edge that is on a cycle, as a path in the direction of the edges that
    starts and ends at its least name. Each cycle appears once, sorted. The graph may have many more cycles, but none
    without these edges."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError:
        paths = [_path(graph, to, name) for name in graph for to in graph[name]]
        return [list(path) for path in sorted({_from_least(path) for path in paths if path})]
    return []


def _path(graph: Mapping[str, Iterable[str]], begin: str, end: str) -> tuple[str, ...]:
    """A shortest path along the edges, both ends included; empty if there is none."""
    before: dict[str, str] = {begin: ""}
    pending = deque([begin])
    while pending and end not in before:
        name = pending.popleft()
        for to in graph.get(name, ()):
            if to not in before:
                before[to] = name
                pending.append(to)
    path = [end] if end in before else []
    while path and before[path[-1]]:
        path.append(before[path[-1]])
    return tuple(reversed(path))


def _from_least(names: tuple[str, ...]) -> tuple[str, ...]:
    """A cycle of names that starts and ends at the least one."""
    start = names.index(min(names))
    return (*names[start:], *names[:start], names[start])


def conflicting(services: Mapping[str, Service], names: Iterable[str]) -> list[tuple[str, str]]:
    """Pairs among `names` that conflict; a conflict that one side declares counts for both."""
    chosen = set(names)
    pairs = {(min(n, c), max(n, c)) for n in chosen if n in services for c in services[n].conflicts if c in chosen}
    return sorted(p for p in pairs if p[0] != p[1])


def overbooked(catalog: Catalog, names: Iterable[str]) -> list[str]:
    """Describes the exclusive resources of which these services together use more than exist."""
    used: dict[str, dict[str, int]] = {}
    for name in sorted(n for n in names if n in catalog.services):
        for resource, units in catalog.services[name].exclusive.items():
            used.setdefault(resource, {})[name] = units
    there = catalog.policy.resources
    return [
        f"{', '.join(users)} use {sum(users.values())} of {there.get(resource, 1)} {resource}"
        for resource, users in sorted(used.items())
        if sum(users.values()) > there.get(resource, 1)
    ]


def stands_on(images: Mapping[str, Image]) -> dict[str, tuple[str, ...]]:
    """Image -> the images that its Dockerfile uses: names of Images of the tree, and the shortest references of
    external ones."""
    return {name: tuple(dict.fromkeys(map(plain, image.bases))) for name, image in images.items()}


def parents_first(images: Mapping[str, Image]) -> list[str]:
    """Images, each after its bases. Raises CycleError, which load() prevents."""
    below = {name: [b for b in bases if b in images] for name, bases in stands_on(images).items()}
    return list(TopologicalSorter(below).static_order())


def made_from(catalog: Catalog) -> dict[str, list[str]]:
    """Image, by its name or shortest reference -> the services that use it, sorted."""
    called = {image.reference: name for name, image in catalog.images.items() if image.reference}
    by_image: dict[str, list[str]] = {}
    for name in sorted(catalog.services):
        spec = catalog.services[name].spec
        if spec is not None:
            by_image.setdefault(called.get(spec["image"]) or plain(spec["image"]), []).append(name)
    return by_image
