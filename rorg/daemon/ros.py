"""The loop's view of ROS: the graphs, parameters, and what killed programs leave behind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from rorg.core.observed import Observed
from rorg.core.ros_graph import Graphs
from rorg.core.situation import Situation
from rorg.daemon.recorder import Recorder
from rorg.daemon.ros2_parameters import ParameterFiles
from rorg.daemon.ros2_watch import Ros2Watch
from rorg.daemon.ros_watch import RosWatch
from rorg.daemon.shared_memory import ShmPurger
from rorg.model.catalog import Catalog
from rorg.model.ros import graph_of_domain
from rorg.probes.ros2_exchange import Ros2Exchange
from rorg.store.state_dir import StateDir


@dataclass(frozen=True)
class Ros:
    """For the loop's thread; no method waits for anything of ROS. `local`: the engine's processes are those of this
    machine."""

    masters: RosWatch
    ros2: Ros2Watch
    parameters: ParameterFiles
    shm: ShmPurger
    local: bool

    def observed(self, observed: Observed, catalog: Catalog) -> Observed:
        """Return what is observed, with the states of managed nodes."""
        return self.ros2.overlay(observed, catalog)

    def graphs(self, catalog: Catalog) -> Graphs:
        return self.ros2.with_graphs(self.masters.graphs, catalog)

    def unreported(self, catalog: Catalog) -> dict[str, float]:
        """Return graphs of ROS 2 with managed nodes that nothing reports -> since when."""
        domains = {s.domain for s in self.ros2.managed(catalog).values() if s.domain is not None}
        return {graph_of_domain(domain): since for domain, since in self.ros2.exchange.unreported(domains).items()}

    def look(self, situation: Situation) -> None:
        """Take over what a pass has found."""
        if self.local:  # a refused connection on this machine says nothing about a node on another machine
            self.masters.look(situation)
            self.shm.look(situation)
        self.ros2.look(situation)


def make_ros(state: StateDir, recorder: Recorder, exchange: Ros2Exchange, wake: Callable[[], None], local: bool) -> Ros:
    """Return it; its threads begin with `masters`."""

    def unwritten(text: str) -> None:
        recorder.event("parameters-unwritten", text)

    return Ros(
        RosWatch(recorder.purged, wake),
        Ros2Watch(exchange),
        ParameterFiles(state.run, unwritten),
        ShmPurger(recorder.shm_purged),
        local,
    )
