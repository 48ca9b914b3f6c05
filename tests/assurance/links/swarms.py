"""Docker engines in networks of their own that are one Swarm."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import docker
import psutil
from common import wait_for
from dockerd import Dockerd, import_base
from links.network import Network, processes_of

PORT = 2377


class Node(Dockerd):
    """One engine of the Swarm, on a computer with a host name and an address of its own."""

    def __init__(self, folder: Path, name: str, network: Network) -> None:
        super().__init__(folder)
        self.name, self.network, self.address = name, network, network.addresses[name]
        self.options = ("--cgroup-parent", f"/rorg-{os.getpid()}-{name}")

    def as_user(self) -> list[str]:
        named = ("unshare", "-u", "sh", "-c", f'hostname {self.name}; exec "$@"', "sh")
        return [*self.network.enter(self.name), *named]

    def api(self) -> docker.APIClient:
        return docker.APIClient(self.host, version="auto", timeout=30)

    def kill(self) -> None:
        """Everything on this computer ends at once, as by a power cut."""
        for process in processes_of(self):
            if psutil.pid_exists(process.pid):
                process.kill()
        self.stop(kill=True)

    def freeze(self) -> None:
        for process in processes_of(self):
            process.suspend()

    def thaw(self) -> None:
        for process in processes_of(self):
            process.resume()


class Swarm:
    """Nodes on their own computers; the first `managers` of them manage."""

    def __init__(self, folder: Path, names: Iterable[str], managers: int = 3) -> None:
        names = tuple(names)
        self.network = Network(names)
        self.nodes = {name: self._node(folder, name) for name in names}
        first, *others = self.nodes.values()
        first.api().init_swarm(f"{first.address}:{PORT}", f"{first.address}:{PORT}")
        tokens = first.api().inspect_swarm()["JoinTokens"]
        for number, node in enumerate(others, 2):
            token = tokens["Manager" if number <= managers else "Worker"]
            node.api().join_swarm(
                [f"{first.address}:{PORT}"], token, f"{node.address}:{PORT}", f"{node.address}:{PORT}"
            )
        self.managers = [self.nodes[name] for name in names[:managers]]
        wait_for(lambda: len(self.ready(first)) == len(names), 30, "all nodes to be ready")

    def _node(self, folder: Path, name: str) -> Node:
        (folder / name).mkdir()
        node = Node(folder / name, name, self.network)
        node.start()
        import_base(node.host)
        return node

    def ready(self, manager: Node) -> list[str]:
        return [n["Description"]["Hostname"] for n in manager.api().nodes() if n["Status"]["State"] == "ready"]

    def leader(self) -> Node:
        """The manager that leads, by the word of one that runs."""
        for node in self.managers:
            if node.process is not None:
                for row in node.api().nodes():
                    if row.get("ManagerStatus", {}).get("Leader"):
                        return self.nodes[row["Description"]["Hostname"]]
        raise AssertionError("no manager leads")

    def running(self) -> dict[str, list[str]]:
        """Service -> the nodes that run it, by their engines and not by the Swarm."""
        found: dict[str, list[str]] = {}
        for node in self.nodes.values():
            for row in node.api().containers() if node.process is not None else ():
                found.setdefault(row["Labels"].get("rorg.io/service", "other"), []).append(node.name)
        return found

    def tasks(self) -> list[dict[str, Any]]:
        return list(self.managers[0].api().tasks())

    def close(self) -> None:
        for node in self.nodes.values():
            node.close()
        self.network.close()
