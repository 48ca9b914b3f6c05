"""Watches the graphs of ROS 1: which service runs each node, which nodes are registered but dead, and which changed
hands. Removes nodes that were killed: SIGKILL leaves a registration behind for ever."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from rorg.core.observed import Observed
from rorg.core.ros_graph import Graphs, RosGraph, Takeover, graph_of, takeovers
from rorg.core.situation import Situation
from rorg.core.status import ros_nodes
from rorg.core.wanted import Wanted
from rorg.host.bounded_http import place_of
from rorg.host.listeners import lineage, listeners, open_ports, own_names
from rorg.model.catalog import Catalog, Service
from rorg.probes.ros_state import RosState, read_state, refuses, unregister

AFTER = (1.0, 3.0, 10.0)
"""Seconds from one look to the next since something changed: nodes register some time after their service has started.
The last one repeats."""
GAP = 0.25
"""Seconds between two looks, at least."""
AFTERWARDS = 15.0
"""Seconds for which a master that no service uses any more is still watched: those that ended may have left
registrations."""
APART = 2.0
"""Seconds between two looks that must both find a node dead before it is unregistered."""


@dataclass(frozen=True, slots=True)
class Run:
    """The run of a service that uses a master."""

    incarnation: str
    pid: int
    nodes: frozenset[str]
    """The nodes that its manifest names."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Runs:
    """The runs of one master, as of a pass of the loop."""

    alive: Mapping[str, Run] = field(default_factory=dict)
    """By service: those that run or are paused."""
    active: frozenset[str] = frozenset()
    """Services that are alive, or wanted."""


class _Owner(NamedTuple):
    """The owner of the program at an address."""

    service: str
    incarnation: str


class RosNodes:
    """The known nodes of a master, kept from one look to the next. `local` are names and addresses of this machine.
    For one thread."""

    def __init__(self, master: str, local: Collection[str]) -> None:
        self.master, self.local = master, local
        self._runs = Runs()
        self._owners: dict[tuple[str, str], _Owner] = {}
        """By (node, its address)."""
        self._last: dict[str, str] = {}
        """Node -> the service that ran it last, as long as that is active."""
        self._dead: dict[tuple[str, str], float] = {}
        """(node, its address) -> when it was first found dead."""
        self._takeovers: tuple[Takeover, ...] = ()

    def look(self, runs: Runs) -> tuple[RosGraph, list[str]]:
        """Return the graph, and the dead nodes that can be unregistered now. Raises OSError if there is no master."""
        state = read_state(self.master)
        self._state = state
        dead = self._find_dead(state)
        nodes = self._who_runs({n: uri for n, uri in state.places.items() if n not in dead}, runs)
        self._takeovers = takeovers(self._takeovers, self._last, nodes, runs.active)
        known = {**self._last, **{n: s for n, s in nodes.items() if s}}
        self._last = {n: s for n, s in known.items() if s in runs.active}
        return _graph(state, nodes, self._takeovers), [node for node, long in dead.items() if long]

    def purge(self, node: str) -> bool:
        """Unregister a node as the last look found it; return whether it was still registered."""
        with contextlib.suppress(LookupError, OSError):
            unregister(self.master, node, self._state)
            return True
        return False

    def _find_dead(self, state: RosState) -> dict[str, bool]:
        """Nodes of this machine at whose addresses nothing listens; with each, whether an earlier look found that too.
        A paused node still listens. It is not connected to needlessly: its queue of connections is short, and is not
        emptied before it is resumed."""
        ports, now = open_ports(), time.monotonic()
        dead_nodes = {
            (node, uri)
            for node, uri in state.places.items()
            if (port := self._port(uri)) and port not in ports and refuses(uri)
        }
        self._dead = {key: self._dead.get(key, now) for key in dead_nodes}
        return {key[0]: now - since >= APART for key, since in self._dead.items()}

    def _port(self, uri: str) -> int:
        """The port of an address on this machine, otherwise 0."""
        with contextlib.suppress(OSError):
            host, port = place_of(uri)
            return port if host in self.local else 0
        return 0

    def _who_runs(self, places: Mapping[str, str], runs: Runs) -> dict[str, str]:
        """Node -> service. Looks for processes only if a node or a run is new."""
        alive = {name: run.incarnation for name, run in runs.alive.items()}
        before, keys = self._owners, {(node, uri) for node, uri in places.items()}
        kept = {k: o for k, o in before.items() if k in keys and alive.get(o.service) == o.incarnation}
        others = {k: o for k, o in before.items() if k in keys and not o.service} if runs == self._runs else {}
        self._owners, self._runs = {**kept, **others}, runs
        if unknown := keys - self._owners.keys():
            self._owners |= self._find_owners(unknown, runs)
        return {node: self._owners[node, uri].service for node, uri in places.items()}

    def _find_owners(self, keys: Collection[tuple[str, str]], runs: Runs) -> dict[tuple[str, str], _Owner]:
        """Find owners by the process that listens at a node's address; otherwise by the manifest that names the
        node."""
        processes, owners = listeners(), {}
        services = {run.pid: name for name, run in runs.alive.items() if run.pid}
        for node, uri in keys:
            forebears = lineage(processes.get(self._port(uri)))
            name = next((services[pid] for pid in forebears if pid in services), "")
            if not forebears:
                named = [service for service, run in runs.alive.items() if node in run.nodes]
                name = named[0] if len(named) == 1 else ""
            owners[node, uri] = _Owner(name, runs.alive[name].incarnation if name else "")
        return owners


def _graph(state: RosState, nodes: Mapping[str, str], changed: tuple[Takeover, ...]) -> RosGraph:
    publishers, subscribers, providers = (
        {name: tuple(sorted(n for n in named if n in nodes)) for name, named in part.items()} for part in state.graph
    )
    return RosGraph(nodes=nodes, publishers=publishers, subscribers=subscribers, providers=providers, takeovers=changed)


@dataclass(frozen=True, slots=True)
class _Watched:
    """What matters here of a pass, by master."""

    runs: dict[str, Runs]
    purge: bool


class RosWatch:
    """Looks at the masters of services that are alive, in a thread of its own: when a service has started or ended, and
    now and then. `purged` is called with each node that was unregistered, `wake` when a graph has changed."""

    def __init__(self, purged: Callable[[str], None], wake: Callable[[], None]) -> None:
        self.purged, self.wake = purged, wake
        self.graphs: Graphs = {}
        """As last seen, by master; a different object after each change. A master that does not answer is left out."""
        self._watched = _Watched({}, False)
        self._seen: tuple[object, object, object] = (None, None, None)
        """The inputs of the last pass that mattered."""
        self._users: Mapping[str, Service] = {}
        """Services of its catalog that use a master of ROS 1."""
        self._changed = threading.Event()
        self._stopping = threading.Event()
        self._masters: dict[str, RosNodes] = {}
        self._used: dict[str, float] = {}
        """Master -> when a service that uses it was last seen alive."""

    def start(self) -> None:
        threading.Thread(target=self._run, name="ros-watch", daemon=True).start()

    def stop(self) -> None:
        self._stopping.set()
        self._changed.set()

    def look(self, situation: Situation) -> None:
        """Take over what a pass has found; never waits for a master."""
        seen = situation.observed, situation.wanted, situation.desired.catalog
        if not situation.observed.complete or all(a is b for a, b in zip(seen, self._seen, strict=True)):
            return
        if self._seen[2] is not situation.desired.catalog:
            self._users = _users(situation.desired.catalog)
        self._seen = seen
        runs = _runs(situation.observed, situation.wanted, self._users)
        watched = _Watched(runs, situation.desired.catalog.policy.purge_ros)
        if watched != self._watched:
            self._watched = watched
            self._changed.set()

    def _run(self) -> None:
        quiet = 0
        """Looks since something changed."""
        while True:
            pause = AFTER[min(quiet, len(AFTER) - 1)] if self._used else None
            quiet = 0 if self._changed.wait(pause) else quiet + 1
            self._changed.clear()
            if self._stopping.is_set():
                return
            self._look()
            self._stopping.wait(GAP)

    def _look(self) -> None:
        watched, now, graphs = self._watched, time.monotonic(), dict[str, RosGraph]()
        self._used |= dict.fromkeys(watched.runs, now)
        for master, used in list(self._used.items()):
            if now - used > AFTERWARDS:
                del self._used[master]
                self._masters.pop(master, None)
                continue
            nodes = self._masters.setdefault(master, RosNodes(master, own_names()))
            try:
                graphs[master], dead = nodes.look(watched.runs.get(master, Runs()))
            except OSError:
                continue  # no master, no graph
            for node in dead if watched.purge else ():
                if nodes.purge(node):
                    self.purged(node)
        if graphs != self.graphs:
            self.graphs = graphs
            self.wake()


def _users(catalog: Catalog) -> dict[str, Service]:
    return {name: s for name, s in catalog.services.items() if s.domain is None and graph_of(s)}


def _runs(observed: Observed, wanted: Wanted, users: Mapping[str, Service]) -> dict[str, Runs]:
    """By master that a living service uses."""
    by_master: dict[str, dict[str, Run]] = {}
    containers = observed.by_service()
    for name in users.keys() & containers.keys():
        service, current = users[name], containers[name][0]
        if current.alive:
            by_master.setdefault(graph_of(service), {})[name] = Run(
                current.incarnation, current.pid, frozenset(ros_nodes(service))
            )
    return {master: Runs(alive=alive, active=frozenset({*alive, *wanted})) for master, alive in by_master.items()}
