"""Watches the graphs of ROS 1, and removes nodes that were killed: SIGKILL leaves a registration behind for ever."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from rorg.core.observed import Observed
from rorg.core.ros_graph import Graphs, RosGraph, master_of
from rorg.core.situation import Situation
from rorg.core.status import ros_nodes
from rorg.core.wanted import Wanted
from rorg.daemon.ros_nodes import RosNodes, Run, Runs
from rorg.host.listeners import own_names
from rorg.model.catalog import Catalog

AFTER = (1.0, 3.0, 10.0)
"""Seconds from one look to the next since something changed: nodes register some time after their service has started.
The last one repeats."""
GAP = 0.25
"""Seconds between two looks, at least."""
AFTERWARDS = 15.0
"""Seconds for which a master that no service uses any more is still watched: those that ended may have left
registrations."""


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
        self._seen = seen
        watched = _Watched(_runs(*seen), situation.desired.catalog.policy.purge_ros)
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


def _runs(observed: Observed, wanted: Wanted, catalog: Catalog) -> dict[str, Runs]:
    """By master that a living service uses."""
    found: dict[str, dict[str, Run]] = {}
    for name, containers in observed.by_service().items():
        service, current = catalog.services.get(name), containers[0]
        master = master_of(service) if service else ""
        if service and master and current.alive:
            found.setdefault(master, {})[name] = Run(current.incarnation, current.pid, frozenset(ros_nodes(service)))
    return {master: Runs(alive=alive, active=frozenset({*alive, *wanted})) for master, alive in found.items()}
