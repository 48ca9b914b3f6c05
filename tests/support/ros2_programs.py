"""Programs of ROS 2 for tests: services of rclpy nodes, and containers of people."""

from __future__ import annotations

import fcntl
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import docker
from common import ROOT

NODES = ROOT / "tests/support/ros2_nodes"


@dataclass(frozen=True)
class Ros2:
    """ROS 2 in an image, and the package of rorg's node. `domain`: no one else's on this machine."""

    host: str
    image: str
    package: Path
    domain: int
    mounts: tuple[str, ...] = ()
    entry: tuple[str, ...] = ()
    """What begins a command that is run inside a container."""

    def container(self, folder: Path) -> dict:
        """Options of a container in which /told is the folder."""
        (python,) = (self.package / "lib").glob("python3.*")
        return {
            "environment": {
                "ROS_DOMAIN_ID": str(self.domain),
                "PYTHONPATH": f"/rorg_ros2/lib/{python.name}/site-packages:/program",
            },
            "volumes": [
                *self.mounts,
                f"{self.package}:/rorg_ros2:ro",
                f"{ROOT / 'clients/python/rorg_client'}:/program/rorg_client:ro",
                f"{NODES}:/nodes:ro",
                f"{folder}:/told",
            ],
        }

    def service(self, command: str, folder: Path, **more: object) -> dict:
        """A service that runs a program of ROS 2."""
        return {
            "image": self.image,
            "profile": "ros2",
            "command": command,
            "container": self.container(folder),
            **more,
        }

    def node(self, folder: Path, **more: object) -> dict:
        """The service of rorg's own node."""
        more = {"may_act_for": ["*"], "always_on": True, **more}
        return self.service("/rorg_ros2/lib/rorg_ros2/rorg_node", folder, ready={"log": "serves requests"}, **more)


@contextmanager
def domain_of_its_own() -> Iterator[int]:
    """A ROS_DOMAIN_ID that no other run of these tests has."""
    for number in range(1, 102):
        with Path(f"/tmp/rorg-tests-domain-{number}.lock").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            yield number
            return
    raise AssertionError("other runs of these tests have all the domains")


class Hand:
    """A person's container: programs of ROS 2 that no service runs."""

    def __init__(self, ros2: Ros2, folder: Path, *mounts: str) -> None:
        self.api, self.entry = docker.APIClient(ros2.host, version="auto"), ros2.entry
        options = ros2.container(folder)
        environment = {**options["environment"], "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        binds = [*options["volumes"], *mounts]
        host = self.api.create_host_config(network_mode="host", ipc_mode="host", binds=binds, init=True)
        words = {"environment": environment, "host_config": host}
        self.id = self.api.create_container(ros2.image, ["sleep", "1200"], **words)["Id"]
        self.api.start(self.id)

    def run(self, *command: str, detach: bool = False) -> str:
        made = self.api.exec_create(self.id, [*self.entry, *command])["Id"]
        return (self.api.exec_start(made, detach=detach) or b"").decode()

    def close(self) -> None:
        self.api.remove_container(self.id, force=True)


def read(path: Path) -> object:
    return json.loads(path.read_text())
