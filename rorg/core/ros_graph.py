"""A ROS graph as a value: which service runs which node, and which nodes are connected.

A master of ROS 1 knows publishers, subscribers and providers of services. It does not know who calls a service, or
whether a topic is latched. The graph of ROS 2 has callers too, and what its reporter says is in the same form.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import chain

from rorg.model.catalog import Service
from rorg.model.ros import graph_of_domain

EVERYBODY = frozenset(("/rosout", "/rosout_agg"))
"""Topics that connect every node with rosout, so they say nothing about how nodes depend on each other."""


@dataclass(frozen=True, slots=True)
class Takeover:
    """A node name that moved from one service to another while both are active or wanted. ROS 1 allows each name once:
    the older node shuts down, or does so when it is resumed."""

    node: str
    former: str
    service: str

    def __str__(self) -> str:
        return f"the ROS node {self.node} of {self.former} is registered by {self.service} now"


@dataclass(frozen=True, slots=True, kw_only=True)
class RosGraph:
    """The graph of one master, or of one domain of ROS 2. Nodes that are registered but dead are left out. Topics and
    services map to sorted names of nodes."""

    nodes: Mapping[str, str] = field(default_factory=dict)
    """Node -> the service that runs it; "" if no service of this robot is known to."""
    publishers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    subscribers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    providers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """ROS service -> nodes that provide it."""
    callers: Mapping[str, tuple[str, ...]] | None = None
    """ROS service -> nodes that call it; None if that is not known."""
    takeovers: tuple[Takeover, ...] = ()

    def of(self, service: str) -> frozenset[str]:
        """Return the nodes that a service runs."""
        return frozenset(node for node, runs in self.nodes.items() if runs == service)


Graphs = Mapping[str, RosGraph]
"""Name of the graph -> graph, for masters that answer and domains that are reported."""


@dataclass(frozen=True, slots=True)
class Connection:
    """A topic that connects nodes of two services."""

    topic: str
    node: str
    """The node of the service in question."""
    other: str
    """The node at the other end."""
    service: str
    """The service of the other node; "" if not known."""
    subscribes: bool
    """Whether `node` subscribes to what `other` publishes; False for the opposite direction."""

    def __str__(self) -> str:
        return f"connected to {self.service or f'the node {self.other}'} by {self.topic}"


def graph_of(service: Service) -> str:
    """Return the name of the ROS graph that the service declares; "" if it has none."""
    if service.domain is not None:
        return graph_of_domain(service.domain)
    return str(service.options.get("environment", {}).get("ROS_MASTER_URI") or "")


def connections(graph: RosGraph, service: str) -> tuple[Connection, ...]:
    """Return all connections of a service with other services, by topic."""
    own = graph.of(service)
    both_directions = chain(
        _connections(own, graph.subscribers, graph.publishers, graph, True),
        _connections(own, graph.publishers, graph.subscribers, graph, False),
    )
    return tuple(sorted(both_directions, key=lambda c: (c.topic, c.node, c.other, c.subscribes)))


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
    """Return nodes that moved from one service to another. `owners` says who ran each node last; `active` are services
    that run, are paused or will run. A service that ended and is unwanted has given up its nodes. A known takeover
    stays as long as both services are active."""
    running = {*active}
    by_node = {t.node: t for t in before if {t.former, t.service} <= running}
    for node, service in nodes.items():
        former, known = owners.get(node, ""), by_node.get(node)
        if former in (service, "") or not {former, service} <= running:
            continue
        if known is None or {known.former, known.service} != {former, service}:
            by_node[node] = Takeover(node, former, service)
    return tuple(by_node[node] for node in sorted(by_node))
