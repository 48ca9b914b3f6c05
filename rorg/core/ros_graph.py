"""The graph of a ROS 1 master as a value: which service runs which node, and who is connected to whom.

The master knows who publishes, who subscribes and who provides a service. It does not know who calls a service, nor
whether a topic is latched.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import chain

from rorg.model.catalog import Service

EVERYBODY = frozenset(("/rosout", "/rosout_agg"))
"""Topics that connect every node with the master's own one, and tell nothing of what nodes have to do with each
other."""


@dataclass(frozen=True, slots=True)
class Takeover:
    """A node that one service ran and another one runs now, while both are to be active or are."""

    node: str
    former: str
    service: str

    def __str__(self) -> str:
        return f"the ROS node {self.node} of {self.former} is registered by {self.service} now"


@dataclass(frozen=True, slots=True, kw_only=True)
class RosGraph:
    """What one master says. Nodes that are dead, though registered, are left out. Topics and services have the names of
    nodes, in order."""

    nodes: Mapping[str, str] = field(default_factory=dict)
    """Node -> the service that runs it; "" where none of this robot is known to."""
    publishers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    subscribers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    providers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """ROS service -> who provides it."""
    takeovers: tuple[Takeover, ...] = ()

    def of(self, service: str) -> frozenset[str]:
        """The nodes that a service runs."""
        return frozenset(node for node, runs in self.nodes.items() if runs == service)


Graphs = Mapping[str, RosGraph]
"""By the URI of their master, those that are known."""


@dataclass(frozen=True, slots=True)
class Connection:
    """A topic by which a node of one service is connected to one of another."""

    topic: str
    node: str
    """Of the service that is asked about."""
    other: str
    """The other node."""
    service: str
    """That runs the other one; "" where none is known to."""
    subscribes: bool
    """`node` gets what `other` publishes; otherwise it is the other way round."""

    def __str__(self) -> str:
        return f"connected to {self.service or f'the node {self.other}'} by {self.topic}"


def master_of(service: Service) -> str:
    """The URI of the ROS 1 master that a service is told; empty where it is told none."""
    return str((service.spec or {}).get("environment", {}).get("ROS_MASTER_URI") or "")


def connections(graph: RosGraph, service: str) -> tuple[Connection, ...]:
    """All of a service with what it does not run itself, by topic."""
    own = graph.of(service)
    found = chain(
        _connections(own, graph.subscribers, graph.publishers, graph, True),
        _connections(own, graph.publishers, graph.subscribers, graph, False),
    )
    return tuple(sorted(found, key=lambda c: (c.topic, c.node, c.other, c.subscribes)))


def _connections(
    own: frozenset[str],
    here: Mapping[str, tuple[str, ...]],
    there: Mapping[str, tuple[str, ...]],
    graph: RosGraph,
    subscribes: bool,
) -> Iterable[Connection]:
    for topic in here.keys() & there.keys() - EVERYBODY:
        for node in own.intersection(here[topic]):
            for other in there[topic]:
                if other in graph.nodes and other not in own:
                    yield Connection(topic, node, other, graph.nodes[other], subscribes)


def takeovers(
    before: Iterable[Takeover], owners: Mapping[str, str], nodes: Mapping[str, str], active: Collection[str]
) -> tuple[Takeover, ...]:
    """Nodes that changed from one service to another. `owners` says who ran each node last; `active` are services that
    run, are paused, or are to run: who has ended and is not wanted has left its nodes to others. One that was told
    stays for as long as both are active."""
    running = {*active}
    found = {t.node: t for t in before if {t.former, t.service} <= running}
    for node, service in nodes.items():
        former, known = owners.get(node, ""), found.get(node)
        if former in (service, "") or not {former, service} <= running:
            continue
        if known is None or {known.former, known.service} != {former, service}:
            found[node] = Takeover(node, former, service)
    return tuple(found[node] for node in sorted(found))
