"""What was acknowledged is there afterwards, whatever is killed when."""

from __future__ import annotations

import contextlib
import os
import random
import resource
import threading
import time

import commands
import pytest
from common import wait_for
from histories import small_disk
from robots import write_tree
from rorg_process import RorgProcess

from rorg.client import Client, Error, NotFound
from rorg.core.masking import Masker
from rorg.daemon.leases import Leases
from rorg.daemon.recorder import Recorder
from rorg.errors import Unreachable
from rorg.model.catalog import Request
from rorg.store.committer import Committer
from rorg.store.requests_file import RequestsFile
from rorg.store.state_dir import StateDir

SECONDS = float(os.environ.get("RORG_TEST_LONG", "0"))
CLIENTS, RESTARTS = 20, 4


class Caller(threading.Thread):
    """Puts, renews and releases its own requests at random, and keeps book of what was acknowledged."""

    def __init__(self, number: int, socket: str, over: threading.Event) -> None:
        super().__init__(daemon=True)
        self.number, self.over = number, over
        self.client = Client(socket, timeout=60.0, patience=60.0)
        self.dice = random.Random(number)
        self.held: dict[str, str] = {}
        """Id -> the reason that was acknowledged last."""
        self.calls = 0
        self.problems: list[str] = []

    def run(self) -> None:
        while not self.over.is_set():
            id = f"c{self.number}-{self.dice.randrange(3)}"
            try:
                self.step(id)
                self.calls += 1
            except Error as error:
                self.problems.append(f"{type(error).__name__}: {error}")

    def step(self, id: str) -> None:
        match self.dice.randrange(4):
            case 0 | 1:
                reason = f"{self.calls}"
                self.client.call("PUT", f"/v1/requests/{id}", {"services": ["camera"], "reason": reason, "ttl": "10m"})
                self.held[id] = reason
            case 2:
                try:
                    self.client.call("POST", f"/v1/requests/{id}/renew")
                    assert id in self.held, f"{id} is there though it was released"
                except NotFound:
                    assert id not in self.held, f"{id} was lost"
            case 3:
                self.client.release(id)
                self.held.pop(id, None)


@pytest.mark.slow
def test_every_acknowledged_change_survives_kill_9(tmp_path):
    tree, state = write_tree(tmp_path / "tree", {"camera": {}}), StateDir(tmp_path / "state").prepare()
    socket = str(state.run / "rorg.sock")

    words = ["run", tree, "--state-dir", state.path, "--engine", "process"]

    def start() -> commands.Forked:
        return commands.Forked(words)

    daemon, over = start(), threading.Event()
    dice, restarts = random.Random(3), 0
    try:
        Client(socket, patience=60).services()
        end = time.monotonic() + SECONDS
        callers = [Caller(n, socket, over) for n in range(CLIENTS)]
        for caller in callers:
            caller.start()
        while restarts < RESTARTS or time.monotonic() < end:
            time.sleep(dice.uniform(0.5, 2.0))  # any moment of whatever they do
            daemon.kill()
            daemon.wait()
            daemon = start()
            restarts += 1
        calls = [c.calls for c in callers]
        wait_for(lambda: all(c.calls > before + 5 for c, before in zip(callers, calls, strict=True)))
        over.set()
        for caller in callers:
            caller.join(60)
            assert not caller.is_alive()
            assert caller.problems == []
        acknowledged = {id: reason for c in callers for id, reason in c.held.items()}
        found = Client(socket, patience=60).requests()
        assert {r["id"]: r["reason"] for r in found} == acknowledged
        assert len(found) == len(acknowledged), "none twice"
        file = RequestsFile(state.requests)
        file.read()
        assert {r.id: r.reason for r in file.document.requests} == acknowledged
        print(f"{sum(c.calls for c in callers)} calls, {restarts} restarts, {len(found)} requests held at the end")
    finally:
        over.set()
        daemon.kill()
        daemon.wait()
        from rorg.engines.make import make_engine

        engine = make_engine("process", state)
        for container in engine.list():
            engine.stop(container.id, "SIGKILL", 5.0)
            engine.remove(container.id)


@pytest.mark.slow
def test_a_held_request_outlives_a_restart_of_rorg(tmp_path):
    """The program that holds it notices nothing, and its service is not touched."""
    from robots import RealRobot

    robot = RealRobot(tmp_path, "process", None, with_server=True)
    robot.declare({"camera": {}})
    try:
        with robot.client().request("camera", wait=20, ttl=1.5) as request:
            before = robot.container("camera").incarnation
            robot.stop()
            robot.start()
            wait_for(lambda: robot.loop.leases.renewals().get(("developer", request.id), 0) >= 2)
            assert robot.container("camera").incarnation == before
        robot.wait(lambda: "camera" not in robot.active())
    finally:
        robot.close()


def test_a_caller_that_gives_up_waiting_stops_no_other_change(tmp_path):
    file = RequestsFile(StateDir(tmp_path).prepare().requests)
    committer = Committer(file, lambda changed: 1)
    given_up, later = (
        committer.submit(lambda asked, id=id: asked.put(Request(id, "developer", ("arm",)))) for id in ("first", "next")
    )
    given_up.cancel()
    committer.start()
    assert later.result(10) == 1
    assert {r.id for r in file.document.requests} == {"first", "next"}
    committer.stop()


def test_a_request_is_acted_on_when_it_is_in_its_place_and_never_if_the_disk_refuses(tmp_path):
    state, seen = StateDir(tmp_path).prepare(), []
    leases = Leases(state.requests, Recorder(state, print, lambda: "2026-01-01T00:00:00Z", Masker()))
    file = RequestsFile(state.requests)

    def changed(_: bool) -> int:
        leases.read()
        seen.append(({r.id for r in leases.document().requests}, state.requests.exists()))
        return len(seen)

    committer = Committer(file, changed)
    leases.committed = file
    committer.start()

    def put(id: str):
        return committer.submit(lambda asked: asked.put(Request(id, "developer", ("arm",))))

    assert put("kept").result(10) == 1
    assert seen == [({"kept"}, True)]
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, limits[1]))  # no file may grow
    try:
        assert isinstance(put("lost").exception(10), Unreachable)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not seen[1:]
    assert put("next").result(10) == 2
    assert {r.id for r in leases.document().requests} == {"kept", "next"}

    before = state.requests.read_text()
    texts: list[str] = []
    committer.changed = lambda _: texts.append(state.requests.read_text()) or 5
    committer.submit(lambda asked: asked.put(Request("kept", "developer", ("gripper",)))).result(10)
    assert texts != [before], "what an acknowledged request asked for counts until another one is in its place"
    committer.stop()


@pytest.mark.slow
def test_a_full_disk_refuses_a_request_and_starts_nothing_twice(tmp_path):
    """What the disk does not take is not acted on; a crashed service comes back once there is room, once."""
    with small_disk(tmp_path / "disk", "8m") as disk:
        (disk / "robot").mkdir()
        begun = tmp_path / "begun"
        services = {
            "arm": {"command": ["sh", "-c", f"echo arm >> {begun}; exec sleep 600"], "always_on": True},
            "cam": {"command": ["sh", "-c", f"echo cam >> {begun}; exec sleep 600"]},
        }
        robot = RorgProcess(disk / "robot", services)
        try:
            robot.start()
            client = robot.client()
            wait_for(lambda: begun.exists() and client.service("arm")["health"] == "Healthy")
            with contextlib.suppress(OSError), (disk / "more").open("wb", 0) as file:
                while file.write(bytes(1024)):
                    pass
            with pytest.raises(Error, match="No space left on device"):
                client.request("cam", id="work", ttl=None)
            robot.kill_service(client.service("arm")["pid"])
            wait_for(lambda: "No space left" in str(client.why("arm")))
            assert begun.read_text().split() == ["arm"]
            (disk / "more").unlink()
            wait_for(lambda: client.service("arm")["health"] == "Healthy")
            client.request("cam", id="work", ttl=None, wait=30)
            assert begun.read_text().split() == ["arm", "arm", "cam"]
        finally:
            robot.close()
