"""What a service may is bounded by its manifest, at every call: also on connections that are open already."""

from __future__ import annotations

import json
import socket
import threading

import pytest
from common import wait_for
from http_message import read_message
from robots import RealRobot

from rorg.client import Error, Forbidden
from rorg.history.retention import Retention

ALPHA = {"always_on": True, "priority": 40, "may_request": ["camera", "lidar"]}
BRIDGE = {"always_on": True, "may_act_for": ["alpha"]}
TREE = {"alpha": ALPHA, "bridge": BRIDGE, "camera": {}, "lidar": {}}


@pytest.fixture
def robot(tmp_path_factory):
    # A folder named after its test is too long for the path of a socket.
    found = RealRobot(tmp_path_factory.mktemp("robot"), "process", None, with_server=True)
    found.declare(TREE)
    found.wait(lambda: {"alpha", "bridge"} <= found.active())
    yield found
    found.close()


class Open:
    """A connection that is kept."""

    def __init__(self, robot: RealRobot, service: str) -> None:
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(20)
        self.socket.connect(robot.socket(service))

    def ask(self, method: str, path: str, body: object = None) -> Open:
        data = b"" if body is None else json.dumps(body).encode()
        head = f"{method} {path} HTTP/1.1\r\nhost: x\r\ncontent-type: application/json\r\n"
        self.socket.sendall(f"{head}content-length: {len(data)}\r\n\r\n".encode() + data)
        return self

    def status(self) -> int:
        """Of one answer."""
        answer = read_message(self.socket)
        assert answer is not None, "the server has hung up"
        return int(answer[0].split(b" ")[1])

    def ends(self) -> bool:
        try:
            while self.socket.recv(1 << 16):
                pass
        except ConnectionError:
            pass
        return True


def under_way(robot: RealRobot, count: int) -> None:
    wait_for(lambda: len(robot.server.uvicorn.server_state.tasks) == count)


def test_a_service_asks_for_no_more_than_its_own_priority(robot):
    own, bridge = robot.client("alpha"), robot.client("bridge")
    for client, requester in ((own, None), (own, "alpha"), (bridge, "alpha")):
        with pytest.raises(Forbidden, match=r"priority 41.*its own is 40"):
            client.request("camera", priority=41, requester=requester)
    assert robot.requests() == ()
    own.request("camera", id="look", priority=40, ttl=None)
    own.request("camera", id="plain", ttl=None)
    robot.client().request("camera", id="urgent", priority=90, requester="alpha", ttl=None)
    assert {r.id: r.priority for r in robot.requests()} == {"look": 40, "plain": None, "urgent": 90}


@pytest.mark.slow
def test_what_is_withdrawn_is_refused_on_open_connections_and_their_leases_run_out(robot):
    own, kept = robot.client("alpha"), Open(robot, "alpha")
    own.call("PUT", "/v1/requests/far", {"services": ["lidar"], "ttl": "2s"})
    own.call("PUT", "/v1/requests/near", {"services": ["camera"], "ttl": "2s"})
    over = threading.Event()

    def keep(id: str) -> None:
        client = robot.client("alpha")
        while not over.wait(0.1):
            try:
                client.call("POST", f"/v1/requests/{id}/renew")
            except Error as error:
                refused[id] = error.code
                return

    refused: dict[str, str] = {}
    keepers = [threading.Thread(target=keep, args=(id,), daemon=True) for id in ("far", "near")]
    for keeper in keepers:
        keeper.start()
    try:
        assert kept.ask("PUT", "/v1/requests/x", {"services": ["lidar"], "ttl": "1s"}).status() == 200
        kept.ask("DELETE", "/v1/requests/x").status()
        robot.declare({**TREE, "alpha": {**ALPHA, "may_request": ["camera"], "priority": 30}})
        wait_for(lambda: refused == {"far": "forbidden"})
        robot.wait(lambda: [r.id for r in robot.requests()] == ["near"])
        assert kept.ask("PUT", "/v1/requests/x", {"services": ["lidar"]}).status() == 403
        assert kept.ask("PUT", "/v1/requests/x", {"services": ["camera"], "priority": 40}).status() == 403
        assert kept.ask("POST", "/v1/requests/near/renew").status() == 200
    finally:
        over.set()
        for keeper in keepers:
            keeper.join(20)
    assert refused == {"far": "forbidden"}


def test_a_service_that_may_nothing_any_more_is_hung_up_on(robot):
    idle, waits, follows = (Open(robot, "alpha") for _ in range(3))
    waits.ask("GET", "/v1/wait?services=camera&timeout=600")
    follows.ask("GET", "/v1/events?follow=true")
    under_way(robot, 2)
    robot.declare({**TREE, "alpha": {"always_on": True}})
    assert all(open.ends() for open in (idle, waits, follows))
    under_way(robot, 0)
    other = Open(robot, "bridge")
    assert other.ask("GET", "/v1/services/camera").status() == 200


def test_who_may_not_act_for_another_any_more_hears_no_more_of_it(robot):
    waits, follows = Open(robot, "bridge"), Open(robot, "bridge")
    waits.ask("GET", "/v1/wait?services=camera&timeout=600&requester=alpha")
    follows.ask("GET", "/v1/events?follow=true&requester=alpha")
    under_way(robot, 2)
    robot.declare({**TREE, "bridge": {**BRIDGE, "may_act_for": ["lidar"]}})
    assert waits.status() == 403
    under_way(robot, 0)


def test_a_typing_error_in_its_name_takes_no_service_its_socket(robot):
    """Its container has the directory mounted: another one in its place would never be seen there."""
    robot.client().request("alpha", id="keep", ttl=None)
    robot.client("alpha").services()
    place = robot.state.run / "services/alpha"
    before = place.stat().st_ino
    kept = Open(robot, "alpha")
    renamed = {n: s for n, s in TREE.items() if n not in ("alpha", "bridge")}
    robot.declare({**renamed, "alhpa": {}})
    robot.wait(lambda: "alpha" in robot.status().get("withheld", {}))
    assert kept.ask("PUT", "/v1/requests/x", {"services": ["camera"]}).status() == 200
    robot.declare(TREE)
    robot.wait(lambda: not robot.status().get("withheld"))
    robot.client("alpha").request("camera", id="look", ttl=None)
    assert place.stat().st_ino == before


def test_a_service_that_floods_the_journal_pushes_out_no_line_of_people(robot, monkeypatch):
    monkeypatch.setattr("rorg.history.journal.RECENT", 20)
    monkeypatch.setattr("rorg.history.maintenance.TRIM", 1)
    monkeypatch.setattr("rorg.daemon.wiring._retention", lambda _: Retention(events=60))
    robot.stop()
    robot.start()
    person, own = robot.client(patience=10), robot.client("alpha", patience=10)
    person.request("camera", id="tour", reason="visitor", ttl=None)
    person.hold("lidar", 600, "calibration")
    for number in range(60):
        own.call("PUT", "/v1/requests/x", {"services": ["camera"], "reason": f"{number}" + "x" * 400, "ttl": "10s"})
        own.call("DELETE", "/v1/requests/x")
    wait_for(lambda: len(list(person.events(cursor=0))) < 70)
    found = list(person.events(cursor=0))
    assert [e["kind"] for e in found if e.get("author") == "root"] == ["request", "hold"]
    assert [e["seq"] for e in found] == sorted(e["seq"] for e in found)
    mine = [e for e in found if e.get("author") == "alpha"]
    assert 10 < len(mine) < 120, "the oldest of its own are gone"
    robot.stop()
    robot.start()
    kept = [e for e in robot.client(patience=10).events(cursor=0) if e["seq"] <= found[-1]["seq"]]
    assert [e for e in kept if e.get("author") == "root"] == [e for e in found if e.get("author") == "root"]
    assert [e for e in found if e in kept] == kept, "the oldest may be gone, and nothing else is otherwise"
