"""The graph of images and their bases, with networkx. Importing that takes 0.3 s, so commands do it only when they need
it, and the loop never does: it uses model/graph.py for the same graph."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import networkx

Graph = Any
"""networkx.DiGraph, which has no types. Its edges lead from a base to the images based on it."""


def hierarchy(below: Mapping[str, Iterable[str]]) -> Graph:
    """The graph of images and their bases, as model.graph.stands_on() returns them. External images are included."""
    graph = networkx.DiGraph()
    graph.add_nodes_from(below)
    graph.add_edges_from((base, name) for name, bases in below.items() for base in bases)
    return graph


def generations(graph: Graph) -> list[list[str]]:
    """Levels of images: each level needs only earlier ones, so its images can be built in parallel. Raises
    networkx.NetworkXUnfeasible for a cycle."""
    return [sorted(names) for names in networkx.topological_generations(graph)]


def descendants(graph: Graph, name: str) -> set[str]:
    """All images based on an image, directly or indirectly: they are rebuilt when it changes."""
    names: set[str] = networkx.descendants(graph, name)
    return names


def reduced(graph: Graph) -> Graph:
    """The graph without edges that follow from longer paths."""
    return networkx.transitive_reduction(graph)


def services_on(graph: Graph, made: Mapping[str, Iterable[str]], name: str) -> list[str]:
    """Services that use an image, or one based on it. `made`: image -> its services, as model.graph.made_from()."""
    return sorted({service for n in {name, *descendants(graph, name)} for service in made.get(n, ())})
