"""What a pass knows of ROS 2: which service runs each node, and which services are inactive because of a managed
node."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from rorg.core.observed import Container, Observed
from rorg.core.ros_graph import Graphs, RosGraph
from rorg.core.situation import Situation
from rorg.core.status import ros_nodes
from rorg.model.catalog import Catalog, Service
from rorg.model.ros import graph_of_domain
from rorg.probes.ros2_exchange import Ros2Exchange, State


class Ros2Watch:
    """For the loop's thread. It never waits."""

    def __init__(self, exchange: Ros2Exchange) -> None:
        self.exchange = exchange
        self._begun: dict[str, tuple[str, float]] = {}
        """Service with managed nodes -> its present run, and when that was first seen."""
        self._inactive: dict[str, tuple[Container, Container]] = {}
        """Container id -> as the engine sees it, and as inactive; unchanged ones stay the same object."""
        self._graphs: tuple[tuple[Graphs, Mapping[int, RosGraph], Catalog] | None, Graphs] = (None, {})
        """The version that the graphs were made from, and the graphs."""
        self._managed: tuple[Catalog | None, Mapping[str, Service]] = (None, {})
        self._overlaid: tuple[object, Observed] | None = None

    def managed(self, catalog: Catalog) -> Mapping[str, Service]:
        """Return the services with managed nodes."""
        if catalog is not self._managed[0]:
            self._managed = catalog, {n: s for n, s in catalog.services.items() if s.managed}
        return self._managed[1]

    def overlay(self, observed: Observed, catalog: Catalog) -> Observed:
        """Return what is observed, with containers as inactive that run a managed node which is not active. A state
        that was asked for before the present run began is not known."""
        managed = self.managed(catalog)
        if not managed:
            return observed
        inactive = dict[str, tuple[Container, Container]]()
        for name, service in managed.items():
            current = observed.current(name)
            if current is None or current.state != "running" or service.domain is None:
                continue
            since = self._since(name, current)
            if _rests(service.managed, self.exchange.states(service.domain), since):
                known = self._inactive.get(current.id)
                pair = known if known and known[0] is current else (current, replace(current, state="inactive"))
                inactive[current.id] = pair
        self._begun = {name: begun for name, begun in self._begun.items() if name in managed}
        same = inactive.keys() == self._inactive.keys() and all(inactive[c] is self._inactive[c] for c in inactive)
        self._inactive = inactive
        if not inactive:
            return observed
        if same and self._overlaid and self._overlaid[0] is observed:
            return self._overlaid[1]
        containers = tuple(inactive[c.id][1] if c.id in inactive else c for c in observed.containers)
        overlaid = replace(observed, containers=containers)
        self._overlaid = observed, overlaid
        return overlaid

    def _since(self, name: str, current: Container) -> float:
        """Return when the present run was first seen."""
        run, since = self._begun.get(name, ("", 0.0))
        if run != current.incarnation:
            since = self.exchange.clock()
            self._begun[name] = current.incarnation, since
        return since

    def look(self, situation: Situation) -> None:
        """Have the managed nodes of services that run watched; paused ones cannot answer."""
        watched: dict[int, tuple[str, ...]] = {}
        for name, service in self.managed(situation.desired.catalog).items():
            current = situation.observed.current(name)
            running = current is not None and current.state in ("running", "inactive")
            if running and service.domain is not None:
                known = watched.get(service.domain, ())
                watched[service.domain] = tuple(dict.fromkeys((*known, *service.managed)))
        self.exchange.watch(watched)

    def with_graphs(self, others: Graphs, catalog: Catalog) -> Graphs:
        """Return the graphs of other kinds with those of ROS 2, by name; the same object while none has changed."""
        made_from = others, self.exchange.graphs(), catalog
        if made_from != self._graphs[0]:
            own = {graph_of_domain(n): _owned(graph, n, catalog) for n, graph in made_from[1].items()}
            self._graphs = made_from, {**others, **own}
        return self._graphs[1]


def _rests(nodes: tuple[str, ...], states: Mapping[str, State], since: float) -> bool:
    """Return whether the state of each node is known, and not all are active."""
    known = [states[node] for node in nodes if node in states and states[node].at >= since]
    return len(known) == len(nodes) and any(state.label != "active" for state in known)


def _owned(graph: RosGraph, domain: int, catalog: Catalog) -> RosGraph:
    """Return the graph with the service of each node; "" if none or several declare it."""
    owners: dict[str, list[str]] = {}
    for name, service in catalog.services.items():
        if service.domain == domain:
            for node in ros_nodes(service):
                owners.setdefault(node, []).append(name)
    nodes = {node: named[0] if len(named := owners.get(node, [])) == 1 else "" for node in graph.nodes}
    return replace(graph, nodes=nodes)
