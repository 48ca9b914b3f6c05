"""What is requested through ROS belongs to the service that runs the caller, and outlives bridges and rorgs."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import docker
import pytest
import yaml
from common import ROOT, free_port, wait_for
from robots import RealRobot, write_tree
from rorg_client.ros.bridge import Bridge
from rorg_client.ros.identity import Connection, Graph
from rorg_client.ros.names import holder_of, request_id, tag
from ros_master import NODES, services
from ros_requests import CYCLES, PAUSE, Rorg, held

LISTEN = [
    "python3",
    "-S",
    "-c",
    "import socket,sys\nwith socket.create_server(('127.0.0.1', int(sys.argv[1]))) as s:\n    while True: s.accept()",
]


class People(Graph):
    """Nodes that are there for as long as somebody says so."""

    def __init__(self, **ports: int) -> None:
        self.ports = {f"/{name}": port for name, port in ports.items()}

    def alive(self, node: str) -> bool:
        return node in self.ports

    def port(self, node: str) -> int:
        return self.ports.get(node, 0)

    def near(self, node: str) -> bool | None:
        return True if node in self.ports else None

    def nodes(self) -> list[str]:
        return list(self.ports)


@pytest.fixture
def port() -> int:
    return free_port()


@pytest.fixture
def robot(tmp_path, port) -> Iterator[RealRobot]:
    """A bridge's service, and `tour`, which runs a node at `port`."""
    found = RealRobot(tmp_path, "process", None, with_server=True)
    found.declare(
        {
            "camera": PAUSE,
            "lamp": PAUSE,
            "rorg_ros": {"always_on": True, "may_request": ["lamp"], "may_act_for": ["*", "developer"]},
            "tour": {
                "command": [*LISTEN, str(port)],
                "may_request": ["camera"],
                "may_manage": ["lab-*"],
                "always_on": True,
            },
        }
    )
    found.wait(lambda: {"tour", "rorg_ros"} <= found.active())
    wait_for(lambda: answers(port))
    yield found
    found.close()


def answers(port: int) -> bool:
    with socket.socket() as made:
        return made.connect_ex(("127.0.0.1", port)) == 0


def test_a_request_belongs_to_the_service_that_runs_the_caller(robot, port):
    bridge = Bridge(robot.client("rorg_ros"), People(tour=port, laptop=0))
    assert bridge.request("/tour", "look", ["camera"], "to see", 20.0) == (True, "requested camera", 0.0)
    assert held(robot) == {"tour": ["camera"]}
    refused = bridge.request("/tour", "light", ["lamp"], "", 0.0)
    assert not refused.success
    assert "tour may request camera" in refused.message
    assert bridge.request("/laptop", "light", ["lamp"], "", 0.0).success
    assert held(robot) == {"tour": ["camera"], "rorg_ros": ["lamp"]}, "of no service: the bridge's own"
    assert not bridge.request("/laptop", "look", ["camera"], "", 0.0).success
    assert bridge.release("/tour", "look") == (True, "released", 0.0)
    assert "camera" not in str(held(robot))
    assert bridge.release("/tour", "look").message == "nothing to release"
    assert "tour may restart nothing" in bridge.restart("/tour", "lamp", False).message
    bridge.request("/tour", "look", ["camera"], "", 0.0)
    robot.kill("tour")
    robot.wait(lambda: held(robot) == {"rorg_ros": ["lamp"]}, 10)


CALLS = """import socket, sys, time
with socket.create_connection(("127.0.0.1", int(sys.argv[1]))):
    time.sleep(600)"""


@pytest.fixture
def stranger(robot) -> Iterator[Callable[[str], Connection]]:
    """How a call of a service's program comes by: `stranger("thief")` declares it, and awaits its connection."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        to, open_ = server.getsockname()[1], []
        server.settimeout(60)

        def call(name: str) -> Connection:
            command = ["python3", "-S", "-c", CALLS, str(to)]
            spec = {"image": "rorg-base", "command": command, "always_on": True, "may_request": ["lamp"]}
            text = {"apiVersion": "rorg/v1", "kind": "Service", "metadata": {"name": name}, "spec": spec}
            (robot.tree / f"services/{name}.yaml").write_text(yaml.safe_dump(text))
            found, peer = server.accept()
            open_.append(found)
            return Connection(True, peer[1], to)

        yield call
        for found in open_:
            found.close()


def test_no_process_speaks_for_a_node_of_another(robot, port, stranger):
    """Nor for one of another machine, nor does one of another machine for a node of this one."""

    class Graph(People):
        def near(self, node: str) -> bool | None:
            return False if node == "/far" else super().near(node)

    bridge = Bridge(robot.client("rorg_ros"), Graph(tour=port, person=0), others="developer")
    assert bridge.request("/tour", "look", ["camera"], "", 20.0).success
    thief, far = stranger("thief"), Connection(False, 0, 0)
    before = robot.requests()
    for via, node in ((thief, "/tour"), (far, "/tour"), (far, "/person"), (thief, "/far")):
        refused = [
            bridge.release(node, "look", via),
            bridge.request(node, "look", ["lamp"], "", 0.0, 0.0, via),
            bridge.restart(node, "camera", True, via),
            bridge.remove_manifest(node, "", "camera", "", "", via),
        ]
        assert all(not done.success and f"cannot call as {node}" in done.message for done in refused), refused
        assert not bridge.put_manifest(node, "", "radio", "", "", "", via)[0]
        assert not bridge.get_manifest(node, "", "camera", via)[0]
    assert "a process of tour, and thief calls" in bridge.release("/tour", "look", thief).message
    assert robot.requests() == before


def test_a_program_without_a_node_of_its_own_has_the_rights_of_its_service(robot, stranger):
    """Not those of whom the bridge takes others for, nor what others hold."""
    bridge = Bridge(robot.client("rorg_ros"), People(), others="developer")
    hand = "/rosservice_12_1700000000000"
    assert bridge.request(hand, "x", ["camera"], "", 0.0).success
    thief = stranger("thief")
    refused = bridge.request(hand, "y", ["camera"], "", 0.0, 0.0, thief)
    assert "thief may request lamp" in refused.message
    assert bridge.release(hand, "x", thief).message == "nothing to release"
    assert held(robot) == {"developer": ["camera"]}
    assert bridge.request(hand, "y", ["lamp"], "", 0.0, 0.0, thief).success
    assert held(robot) == {"developer": ["camera"], "thief": ["lamp"]}
    assert bridge.release(hand, "y").message == "nothing to release", "nor do others for it"
    assert bridge.release(hand, "y", thief).message == "released"


def test_of_processes_that_no_service_runs_each_speaks_for_itself(robot):
    """A node in this process, and a call of this one and of another."""
    with socket.create_server(("127.0.0.1", 0)) as node, socket.create_server(("127.0.0.1", 0)) as server:
        to = server.getsockname()[1]
        bridge = Bridge(robot.client("rorg_ros"), People(person=node.getsockname()[1]))
        with socket.create_connection(("127.0.0.1", to)) as own:
            accepted = server.accept()[0]
            assert bridge.request("/person", "x", ["lamp"], "", 0.0, 0.0, Connection(True, own.getsockname()[1], to))
            accepted.close()
        other = subprocess.Popen([sys.executable, "-S", "-c", CALLS, str(to)])
        try:
            server.settimeout(60)
            accepted, peer = server.accept()
            refused = bridge.release("/person", "x", Connection(True, peer[1], to))
            assert f"(pid {os.getpid()}), and no service (pid {other.pid}) calls" in refused.message
            assert held(robot) == {"rorg_ros": ["lamp"]}
            assert bridge.release("/person", "x").message == "released", "where nobody sees who calls"
            accepted.close()
        finally:
            other.kill()
            other.wait()


def test_a_request_by_hand_lives_for_its_lease(robot):
    bridge = Bridge(robot.client("rorg_ros"), People())
    told = bridge.request("/rosservice_12_1700000000000", "x", ["lamp"], "", 20.0)
    assert (told.success, told.lease) == (True, 60.0)
    assert "60s after its caller is gone" in told.message
    assert bridge.sweep() == []
    assert held(robot) == {"rorg_ros": ["lamp"]}
    assert bridge.release("/rosservice_13_1700000000001", "x").message == "released", "by another call of the same hand"
    assert held(robot) == {}
    began = time.monotonic()
    assert bridge.request("/unnamed", "x", ["lamp"], "", 0.0, 2.0).lease == 2.0
    robot.wait(lambda: (bridge.sweep(), held(robot) == {})[1], 20)
    assert time.monotonic() - began > 1.9
    assert not bridge.request("/unnamed", "x", ["lamp"], "", 0.0, float("nan")).success


def test_a_passing_node_keeps_what_it_holds_while_it_is_there(robot):
    node = "/look_77_1700000000000"
    graph = People(**{node[1:]: 0})
    bridge = Bridge(robot.client("rorg_ros"), graph)
    assert bridge.request(node, "", ["lamp"], "", 0.0, 2.0).success
    until = time.monotonic() + 2.5
    robot.wait(lambda: (bridge.sweep(), time.monotonic() > until)[1])
    assert held(robot) == {"rorg_ros": ["lamp"]}, "it was renewed"
    graph.ports.clear()
    assert bridge.sweep() == [], "its lease ends it"
    robot.wait(lambda: held(robot) == {}, 20)


def test_what_callers_hold_outlives_the_bridge_and_is_watched_again(robot, port):
    graph = People(tour=port, laptop=0, guest=0)
    bridge = Bridge(robot.client("rorg_ros"), graph)
    for node, name in (("/tour", "camera"), ("/laptop", "lamp"), ("/guest", "lamp")):
        assert bridge.request(node, "x", [name], "", 20.0).success
    before, run = robot.requests(), robot.container("rorg_ros").incarnation
    robot.kill("rorg_ros")
    del graph.ports["/guest"]  # while nobody looks
    robot.wait(lambda: "rorg_ros" in robot.active() and robot.container("rorg_ros").incarnation != run)
    robot.settle()
    assert robot.requests() == before
    assert {"camera", "lamp"} <= robot.active()
    again = Bridge(robot.client("rorg_ros"), graph)
    assert again.sweep() == []
    del graph.ports["/laptop"]
    assert again.sweep() == ["/laptop"]
    robot.wait(lambda: [r.id for r in robot.requests()] == ["ros1:tour:x", "ros1:guest:x"])
    assert again.release("/tour", "x").message == "released"
    assert again.request("/guest", "x", ["lamp"], "again", 0.0).success
    assert held(robot) == {"rorg_ros": ["lamp"]}


def test_a_hand_that_asks_again_keeps_what_a_bridge_has_taken_over(robot):
    hand = "/rosservice_12_1700000000000"
    assert Bridge(robot.client("rorg_ros"), People()).request(hand, "x", ["lamp"], "", 20.0).success
    bridge = Bridge(robot.client("rorg_ros"), People(**{hand[1:]: 0}))
    assert bridge.sweep() == []
    assert bridge.request(hand, "x", ["lamp"], "", 0.0).success
    assert held(robot) == {"rorg_ros": ["lamp"]}


def test_who_came_back_keeps_what_it_asked_for_since(robot):
    class Back(People):
        """Gone; and asks again while it is looked for."""

        def alive(self, node: str) -> bool:
            assert bridge.request(node, "x", ["lamp"], "again", 0.0, 30.0).success
            return False

    bridge = Bridge(robot.client("rorg_ros"), People(laptop=0))
    assert bridge.request("/laptop", "x", ["lamp"], "", 0.0).lease == 0
    bridge.graph = Back()
    assert bridge.sweep() == []
    assert [r.ttl for r in robot.requests()] == [30.0]


def test_manifests_are_changed_with_the_rights_of_the_requester(robot, port):
    bridge = Bridge(robot.client("rorg_ros"), People(tour=port), others="developer")
    text = yaml.safe_dump(
        {
            "apiVersion": "rorg/v1",
            "kind": "Service",
            "metadata": {"name": "lab-radio"},
            "spec": {"image": "rorg-base", "command": ["sleep", "600"]},
        }
    )
    other = text.replace("lab-radio", "radio")
    assert "tour may manage lab-*" in bridge.put_manifest("/tour", "", "radio", other, "", "")[1]
    assert bridge.put_manifest("", "", "radio", other, "", "")[0], "of others: a developer"
    done, message, digest = bridge.put_manifest("/tour", "", "lab-radio", text, "", "a radio")
    assert (done, message) == (True, "written to services/lab-radio.yaml")
    assert bridge.request("/tour", "x", ["lab-radio"], "", 20.0).success
    assert bridge.get_manifest("/tour", "Service", "lab-radio") == (True, "", text, digest)
    assert "one already exists" in bridge.put_manifest("/tour", "", "lab-radio", text, "", "")[1]
    assert bridge.put_manifest("/tour", "", "lab-radio", text.replace("600", "500"), digest, "")[0]
    assert "changed meanwhile" in bridge.remove_manifest("/tour", "", "lab-radio", digest, "").message
    assert bridge.remove_manifest("/tour", "", "lab-radio", "", "").success
    assert not bridge.get_manifest("/tour", "", "lab-radio")[0]


def test_a_bridge_acts_only_for_whom_its_manifest_names(tmp_path):
    robot = RealRobot(tmp_path, "process", None, with_server=True)
    robot.declare(
        {
            "lamp": {},
            "tour": {"may_request": ["lamp"], "always_on": True},
            "guide": {"may_request": ["lamp"], "always_on": True},
            "bridge": {"may_act_for": ["tour"], "always_on": True},
            "bridges": {"may_act_for": ["*"], "always_on": True},
        }
    )
    try:
        robot.wait(lambda: {"tour", "guide", "bridge", "bridges"} <= robot.active())
        one, all_but = robot.client("bridge"), robot.client("bridges")
        for client, name in ((one, "tour"), (all_but, "tour"), (all_but, "guide")):
            client.request("lamp", id="x", ttl=None, requester=name)
            client.release("x", name)
        for client, name in ((one, "guide"), (one, "developer"), (all_but, "developer"), (all_but, "nobody")):
            with pytest.raises(Exception, match=f"may_act_for: \\[{name}\\]"):
                client.request("lamp", id="x", ttl=None, requester=name)
    finally:
        robot.close()


def test_no_two_callers_share_a_request():
    assert request_id("ros1", "/tour/guide", "look") == "ros1:tour.guide:look"
    names = [
        ("/a" * 100, "b"),
        ("/a" * 100, "c"),
        ("/a/b", "c"),
        ("/a", "b.c"),
        ("/a.b", "c"),
        ("/a", "b:c"),
        ("/", ""),
        ("/a", ""),
        ("/a", "é"),
        ("/a", "e" * 100),
        ("/a", "e" * 101),
        ("/" + "x" * 41, "e" * 100),
    ]
    made = [request_id("ros1", *name) for name in names]
    assert len(set(made)) == len(names)
    assert max(map(len, made)) <= 64
    assert [m.split(":")[1] for m in made] == [tag(name) for name, _ in names]
    assert holder_of("/rosservice_12_1700000000000") == holder_of("") == "/rosservice"


@pytest.fixture
def hand(dockerd, ros_image, package, tmp_path) -> Iterator[Hand]:
    found = Hand(dockerd.host, ros_image, package, tmp_path)
    yield found
    found.close()


class Hand:
    """A person's container: ROS programs that no service runs."""

    def __init__(self, host: str, image: str, package: Path, folder: Path) -> None:
        self.api = docker.APIClient(host, version="auto")
        self.master = f"http://localhost:{free_port()}"
        self.folder = folder
        self.ros = {
            "environment": {
                "ROS_MASTER_URI": self.master,
                "ROS_HOSTNAME": "localhost",
                "ROS_PACKAGE_PATH": "/bridge/share",
                "PYTHONPATH": "/bridge/lib/python3/dist-packages:/program",
            },
            "volumes": [
                f"{package}:/bridge:ro",
                f"{ROOT}/clients/python/rorg_client:/program/rorg_client:ro",
                f"{NODES}:/nodes:ro",
                f"{self.folder}:/told",
            ],
        }
        self.id = self.api.create_container(
            image,
            ["sleep", "600"],
            environment=self.ros["environment"],
            host_config=self.api.create_host_config(network_mode="host", binds=self.ros["volumes"], init=True),
        )["Id"]
        self.api.start(self.id)

    def run(self, *command: str, detach: bool = False) -> str:
        made = self.api.exec_create(self.id, list(command))["Id"]
        return (self.api.exec_start(made, detach=detach) or b"").decode()

    def close(self) -> None:
        self.api.remove_container(self.id, force=True)


@pytest.mark.docker
def test_ros_callers_get_through_the_end_of_the_bridge_and_of_rorg(dockerd, ros_image, hand, tmp_path):
    robot = RealRobot(tmp_path, "docker", dockerd.host)
    tree = services(ros_image, hand.master)
    ros = {"image": ros_image, "profile": "ros1", "container": hand.ros}
    tree |= {
        "camera": PAUSE,
        "lamp": PAUSE,
        "slow": {"ready": {"delay": "4s"}},
        "rorg_ros": {
            **ros,
            "command": "/bridge/lib/rorg_ros/rorg_node.py",
            "ready": {"ros_node": "/rorg"},
            "always_on": True,
            "may_request": ["lamp"],
            "may_act_for": ["*"],
        },
        "tour": {
            **ros,
            "command": f"python3 /nodes/cycles.py /told/cycles camera {CYCLES}",
            "needs": ["rorg_ros"],
            "may_request": ["camera"],
            "restart": "never",
        },
        "waiter": {
            **ros,
            "command": "python3 /nodes/ask.py /told/waiter waiter lamp slow",
            "needs": ["rorg_ros"],
            "may_request": ["slow"],
            "restart": "never",
        },
    }
    write_tree(robot.tree, tree)
    rorg = Rorg(robot)
    try:
        robot.request("tour", id="run")
        robot.wait(lambda: (hand.folder / "cycles").exists(), 120 + CYCLES)
        assert json.loads((hand.folder / "cycles").read_text()) == [], "told ready and found otherwise"
        assert held(robot) == {"developer": ["tour"], "tour": ["camera"]}

        _by_hand(robot, hand)
        hand.run("python3", "/nodes/ask.py", "/told/laptop", "laptop", "lamp", detach=True)
        robot.wait(lambda: (hand.folder / "laptop").exists())
        assert json.loads((hand.folder / "laptop").read_text()) == [[True, "requested lamp"]]
        assert held(robot)["rorg_ros"] == ["lamp", "lamp"]
        _kill_bridge(robot)
        hand.run("pkill", "-KILL", "-f", "ask.py")
        robot.wait(lambda: held(robot)["rorg_ros"] == ["lamp"])

        robot.request("waiter", id="wait")
        robot.wait(lambda: "slow" in robot.active(), 60)
        for kill in (True, False):
            rorg.end(kill)
            rorg.start()
            robot.wait(lambda: robot.client().service("slow")["wanted"])
        robot.wait(lambda: (hand.folder / "waiter").exists(), 60)
        light, slow = json.loads((hand.folder / "waiter").read_text())
        assert slow == [True, "requested slow"]
        assert light[0] is False
        assert "waiter may request slow" in light[1]
        assert held(robot)["waiter"] == ["slow"]
        assert held(robot)["tour"] == ["camera"]
    finally:
        rorg.end()
        print("\n".join(rorg.log.read_text().splitlines()[-40:]))
        robot.close()


def _by_hand(robot: RealRobot, hand: Hand) -> None:
    told = hand.run("rosservice", "call", "/rorg/request", "{id: x, services: [lamp], wait: 30}")
    assert "success: True" in told, told
    assert "lease: 60.0" in told, told
    until = time.monotonic() + 1.5
    robot.wait(lambda: time.monotonic() > until)
    assert held(robot)["rorg_ros"] == ["lamp"], "though its caller is gone"
    assert "lamp" in robot.active(), "though its caller is gone"
    assert "released" in hand.run("rosservice", "call", "/rorg/release", "{id: x}")
    assert "rorg_ros" not in held(robot)
    told = hand.run("rosservice", "call", "/rorg/request", "{id: x, services: [lamp]}")
    assert "success: True" in told, told
    assert "lease: 60.0" in told, told


def _kill_bridge(robot: RealRobot) -> None:
    """Nothing that its callers use is touched until the next one serves them."""

    def runs() -> list:
        return [(c.service, c.incarnation, c.state) for c in robot.containers() if c.service in ("camera", "lamp")]

    robot.wait(lambda: {"camera", "lamp"} <= robot.active())
    before, asked, old = runs(), robot.requests(), robot.container("rorg_ros").incarnation
    client = robot.client()
    robot.kill("rorg_ros")

    def again() -> bool:
        assert runs() == before
        assert robot.requests() == asked
        found = client.service("rorg_ros")
        return found["health"] == "Healthy" and found["incarnation"] not in ("", old)

    robot.wait(again, 60)
