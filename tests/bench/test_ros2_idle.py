"""What idling costs a managed node of ROS 2: the same node paused, deactivated and stopped, in turn: `make bench`.

ROUNDS of each, 15 by default. The node has a timer of 20 Hz, which goes on while it is inactive.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from statistics import median

import docker
from common import wait_for
from robots import Daemon, RealRobot, write_tree
from ros2_programs import Ros2

ROUNDS = int(os.environ.get("ROUNDS", "15"))
WINDOW = 3.0
"""Seconds over which CPU is measured."""
RESTS = {"pause": "paused", "deactivate": "inactive", "stop": "exited"}
"""Idle action -> the state that it leads to. A service is named after its action."""


class Usage:
    """CPU of the containers of services, in percent of a core."""

    def __init__(self, robot: RealRobot) -> None:
        self.api = docker.APIClient(robot.host, version="auto")
        self.ids = {name: robot.container(name).id for name in RESTS}

    def over(self, seconds: float) -> dict[str, float]:
        before, began = self._used(), time.monotonic()
        time.sleep(seconds)
        after, took = self._used(), time.monotonic() - began
        return {name: (after[name] - before[name]) / took / 1e7 for name in RESTS}

    def _used(self) -> dict[str, int]:
        """Nanoseconds; 0 of a container that has exited."""
        stats = {name: self.api.stats(id, stream=False, one_shot=True) for name, id in self.ids.items()}
        return {name: told["cpu_stats"]["cpu_usage"].get("total_usage", 0) for name, told in stats.items()}


def managed(ros2: Ros2, folder: Path, action: str) -> dict:
    more = {"ros": {"lifecycle": [f"/{action}"]}, "idle": {"action": action}}
    return ros2.service(f"python3 /nodes/managed.py {action}", folder, **more)


def test_pause_deactivate_and_stop_side_by_side(dockerd, ros2: Ros2, tmp_path):
    robot = RealRobot(tmp_path, "docker", dockerd.host)
    nodes = {action: managed(ros2, tmp_path, action) for action in RESTS}
    write_tree(robot.tree, {**nodes, "graph": ros2.node(tmp_path, may_report_graph=True)})
    daemon = Daemon(robot)
    daemon.start()
    back, active, idle = ({action: [] for action in RESTS} for _ in range(3))
    try:
        wait_for(daemon.status, 30, "rorg to run")
        client = robot.client()
        client.wait("graph", timeout=60)
        for number in range(ROUNDS + 1):  # the first one creates the containers, and is left out
            requests = []
            for action in RESTS:
                began = time.monotonic()
                requests.append(client.request(action, wait=60))
                back[action].append(1000 * (time.monotonic() - began))
            usage = Usage(robot)
            for action, share in (usage.over(WINDOW) if number else {}).items():
                active[action].append(share)
            for request in requests:
                request.release()
            for action, state in RESTS.items():
                wait_for(lambda action=action, state=state: client.service(action)["state"] == state, 30, action)
            for action, share in (usage.over(WINDOW) if number else {}).items():
                idle[action].append(share)
    finally:
        daemon.stop()
        robot.close()
    load = " ".join(f"{number:.1f}" for number in os.getloadavg())
    print(f"\n{ROUNDS} rounds, load {load} on {os.cpu_count()}; medians (least to most):", end="")
    for action in RESTS:
        times = back[action][1:]
        print(
            f"\n{action}: ready again after {median(times):.0f} ms ({min(times):.0f} to {max(times):.0f}); "
            f"CPU {median(active[action]):.2f} % active, {median(idle[action]):.2f} % idle "
            f"({min(idle[action]):.2f} to {max(idle[action]):.2f})",
            end="",
        )
    assert median(back["pause"][1:]) < median(back["stop"][1:])
    assert median(back["deactivate"][1:]) < median(back["stop"][1:])
