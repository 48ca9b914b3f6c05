"""What images stand on, as a graph of networkx. Importing that takes 0.3 s, so commands do it once they need it, and
the loop never does: what it needs of the same graph is in model/graph.py."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import networkx

Graph = Any
"""networkx.DiGraph, which has no types. Its arrows lead from an image to those that stand on it."""


def hierarchy(below: Mapping[str, Iterable[str]]) -> Graph:
    """Of images, each with what it stands on, as model.graph.stands_on() has them: external ones are in it too."""
    graph = networkx.DiGraph()
    graph.add_nodes_from(below)
    graph.add_edges_from((base, name) for name, bases in below.items() for base in bases)
    return graph


def generations(graph: Graph) -> list[list[str]]:
    """Level by level: first what stands on nothing, then always what stands on the level before, and perhaps on
    earlier ones. Those of one level can be built at the same time. Raises networkx.NetworkXUnfeasible for a circle."""
    return [sorted(names) for names in networkx.topological_generations(graph)]


def descendants(graph: Graph, name: str) -> set[str]:
    """All that stands on an image, directly or by way of others: what a change of it makes anew."""
    found: set[str] = networkx.descendants(graph, name)
    return found


def reduced(graph: Graph) -> Graph:
    """Without the arrows that a longer way says already."""
    return networkx.transitive_reduction(graph)


def services_on(graph: Graph, made: Mapping[str, Iterable[str]], name: str) -> list[str]:
    """The services that stand on an image, where `made` says which are made from which, as model.graph.made_from()."""
    return sorted({service for n in {name, *descendants(graph, name)} for service in made.get(n, ())})
