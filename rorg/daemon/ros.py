"""Keeps the ROS 1 graph free of nodes that were killed: SIGKILL leaves a registration behind for ever."""

from __future__ import annotations

import queue
import socket
import threading
from collections.abc import Callable

from rorg.core.situation import Situation
from rorg.probes import ros_master

LOCAL = ("localhost", "127.0.0.1", "::1")


class RosPurger:
    """Looks after the master, in a thread of its own, whenever a run of a ROS 1 service has ended. `tell` hears of
    each node that was taken out."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self.tell = tell
        self._runs: dict[str, str] = {}
        """Service -> its run, as seen by the last pass."""
        self._masters: queue.Queue[str] = queue.Queue()

    def start(self) -> None:
        threading.Thread(target=self._run, name="ros-purger", daemon=True).start()

    def stop(self) -> None:
        self._masters.put("")

    def look(self, situation: Situation) -> None:
        """Notices runs that ended since the pass before."""
        if not situation.observed.complete or not situation.desired.catalog.policy.purge_ros:
            return
        runs = {c.service: c.incarnation for c in situation.observed.containers if c.alive}
        ended = [name for name, run in self._runs.items() if runs.get(name) != run]
        self._runs = runs
        services = situation.desired.catalog.services
        masters = {
            m
            for name in ended
            if name in services
            if (m := (services[name].spec or {}).get("environment", {}).get("ROS_MASTER_URI"))
        }
        for master in masters:
            self._masters.put(master)

    def _run(self) -> None:
        while master := self._masters.get():
            try:
                for node in ros_master.purge(master, {*LOCAL, *_own_names()}):
                    self.tell(node)
            except (OSError, LookupError):
                continue  # no master, no registrations


def _own_names() -> set[str]:
    name = socket.gethostname()
    try:
        return {name, *(str(info[4][0]) for info in socket.getaddrinfo(name, None))}
    except OSError:
        return {name}
