"""What goes wrong around the loop: full disks, spoilt files, threads that cannot be had, an rorg that dies halfway."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace

import pytest
from common import wait_for
from robots import RealRobot, VirtualRobot, handed_on, write_tree
from rorg_process import RorgProcess
from updates import retry
from virtual_time import later

from rorg.core.digest import Rules, declared_of, rules_of
from rorg.core.memory import Memory
from rorg.core.observed import Container
from rorg.daemon.saved_memory import remembered
from rorg.daemon.snapshot import snapshot
from rorg.engines.observe import Observer
from rorg.engines.process.engine import ProcessEngine


@pytest.fixture
def robot(tmp_path):
    found = RealRobot(tmp_path, "process", None)
    yield found
    found.close()


@pytest.fixture
def virtual(tmp_path):
    return VirtualRobot(tmp_path)


def another_rorg(virtual) -> None:
    """The one of now is killed; the next one finds what it had kept."""
    virtual.sim._events.clear()
    virtual.sim.memory = handed_on(virtual.sim.decision)


# -- an rorg that begins again ---------------------------------------------------------------------------------


@pytest.mark.parametrize("restart", ["always", "on-failure", "never"])
def test_what_an_rorg_stopped_the_next_one_starts(virtual, restart):
    virtual.declare({"job": {"restart": restart}})
    virtual.request("job")
    virtual.wait(lambda: virtual.active() == {"job"})
    virtual.release()
    virtual.settle()
    virtual.sim.step()
    another_rorg(virtual)
    virtual.request("job")
    virtual.wait(lambda: virtual.active() == {"job"}, 10)


@pytest.mark.parametrize("restart", ["always", "on-failure", "never"])
def test_a_restart_that_is_cut_in_halves_is_finished(virtual, restart):
    virtual.declare({"arm": {"restart": restart, "needs": [{"service": "core", "restart": True}]}, "core": {}})
    virtual.request("arm")
    virtual.settle()
    later(virtual, 5)
    virtual.sim.faults.hang["start", "arm"] = 5.0
    virtual.kill("core")
    virtual.wait(lambda: virtual.states()["arm"] == "exited")
    another_rorg(virtual)
    virtual.wait(lambda: virtual.active() == {"arm", "core"}, 20)


@pytest.mark.parametrize(
    "kept",
    [
        None,
        [1],
        5,
        "x",
        {"run": "x"},
        {"run": 1, "needs": ["core"]},
        {"needs": {"core": 5}, "stopped": [], "tries": {"start": [1, "x", None]}, "content": 5, "crashes": "y"},
    ],
)
def test_whatever_was_kept_an_rorg_begins(virtual, kept):
    virtual.declare({"arm": {"always_on": True, "needs": [{"service": "core", "restart": True}]}, "core": {}})
    virtual.settle()
    before = virtual.container("arm").incarnation
    virtual.sim.memory = remembered({"arm": kept}, virtual.now(), "")
    later(virtual, 5)
    assert virtual.container("arm").incarnation == before
    snapshot(virtual.sim.decision, {})


def test_a_status_file_that_is_no_json_is_passed_over(robot):
    robot.state.status.write_text("[" * 20000)
    robot.declare({"arm": {"always_on": True}})
    robot.wait(lambda: robot.active() == {"arm"})


# -- the engine ------------------------------------------------------------------------------------------------


def test_back_off_outlives_a_moment_without_the_engine(virtual):
    virtual.declare({"arm": {"always_on": True}})
    virtual.settle()
    virtual.sim.faults.crash_after["arm"] = 0.1
    virtual.kill("arm")
    virtual.wait(lambda: virtual.sim.memory.of("arm").exits >= 6)
    began = sum("> start arm" in line for line in virtual.log())
    virtual.sim.faults.unreachable = True
    later(virtual, 1)
    virtual.sim.faults.unreachable = False
    later(virtual, 5)
    assert sum("> start arm" in line for line in virtual.log()) == began


def test_a_container_that_its_engine_cannot_start_any_more_makes_way_for_another_one(virtual):
    virtual.declare({"arm": {}, "base": {"needs": ["arm"]}})
    virtual.settle()
    spent = virtual.container("arm").id
    virtual.sim.faults.spent.add(spent)
    virtual.request("base")
    virtual.wait(lambda: virtual.active() == {"arm", "base"}, 5)
    assert virtual.container("arm").id != spent
    assert len(virtual.containers()) == 2
    assert not virtual.sim.memory.of("arm").crashes


@pytest.mark.parametrize("fits", [True, False])
def test_so_does_one_of_a_change(virtual, fits):
    """The new one, or the one before it, that is gone back to: then nothing runs before a person says so."""
    virtual.declare({"arm": {"always_on": True}})
    virtual.settle()
    first = virtual.container("arm").id
    later_edition = {"arm": {"always_on": True, "container": {"environment": {"N": "1"}}}}
    virtual.declare(later_edition)
    virtual.wait(lambda: len(virtual.containers()) == 2)
    second = next(c.id for c in virtual.containers() if c.id != first)
    spent = second if fits else first
    virtual.sim.faults.spent.add(spent)
    bad = virtual.sim.faults.bad
    bad.update({} if fits else {virtual.sim.desired.digests["arm"]: "exit"})
    virtual.wait(lambda: spent not in {c.id for c in virtual.containers()})
    bad.clear()
    if not fits:
        later(virtual, 120)
        assert not virtual.active()
        assert "its previous container is gone" in virtual.waits("arm")
        retry(virtual, "arm")
    virtual.wait(lambda: virtual.active() == {"arm"}, 120)
    virtual.settle()
    assert virtual.container("arm").id not in (first, spent)
    assert "its change failed" not in virtual.waits("arm")


class Curt:
    """An engine that was too busy to tell more of a container than its state."""

    def __init__(self, *containers: Container) -> None:
        self.containers = list(containers)

    def list(self, known=None) -> list[Container]:
        return self.containers


def test_a_container_that_is_not_told_all_of_is_still_the_one_it_was():
    arm = Container("a" * 64, "arm", "arm", "running", "2026-01-01T00:00:00Z", digest="v1:x", pid=7)
    engine = Curt(arm)
    observer = Observer(engine, lambda: None, lambda: 60.0)
    observer.sync()
    engine.containers = [Container(arm.id, "arm", "arm", "paused", digest="v1:x", brief=True)]
    observer.sync()
    (seen,) = observer.snapshot().containers
    assert (seen.incarnation, seen.state) == (arm.incarnation, "paused")
    engine.containers = [Container(arm.id, "arm", "arm", "exited", digest="v1:x", brief=True)]
    observer.sync()
    assert observer.snapshot().containers[0].incarnation == arm.incarnation


def test_nor_is_anything_concluded_of_one_that_was_never_seen_whole(virtual):
    virtual.declare(
        {"arm": {"always_on": True, "needs": [{"service": "core", "restart": True}]}, "core": {}, "cam": {}}
    )
    virtual.settle()
    virtual.request("cam", id="look", by="arm")
    virtual.settle()
    before, whole = {c.service: c.incarnation for c in virtual.containers()}, virtual.sim.engine.list
    virtual.sim.memory = Memory()
    for name in ("arm", "core"):
        virtual.sim.engine.list = lambda name=name: [
            replace(c, started_at="", brief=True) if c.service == name else c for c in whole()
        ]
        later(virtual, 3)
        virtual.sim.engine.list = whole
        later(virtual, 3)
    assert {c.service: c.incarnation for c in virtual.containers()} == before
    assert [r.id for r in virtual.requests()] == ["look"]


def test_one_spoilt_record_hides_no_container(robot):
    robot.declare({"arm": {}, "cam": {}})
    robot.request("arm")
    robot.wait(lambda: robot.active() == {"arm"})
    spoilt = robot.state.path / "process/spoilt"
    spoilt.mkdir()
    (spoilt / "record.json").write_text("{}")
    robot.request("cam", id="cam")
    robot.wait(lambda: robot.active() == {"arm", "cam"})
    robot.kill("arm")
    robot.wait(lambda: any("arm ended" in line for line in robot.lines))
    robot.wait(lambda: robot.active() == {"arm", "cam"})


def test_whatever_an_engine_answers_it_is_asked_again(monkeypatch):
    engine, answers = Curt(), []

    def events(stop):
        answers.append(1)
        if len(answers) == 1:
            raise KeyError("labels")
        yield "", ""
        stop.wait(10)

    engine.events = events
    observer = Observer(engine, lambda: None, lambda: 60.0)
    observer.start()
    wait_for(lambda: observer.snapshot().complete)
    observer.stop()
    assert len(answers) == 2


def test_a_process_whose_name_is_no_text_is_in_nobodys_way(robot):
    name = "überwachungsdä".encode()[:15]
    stranger = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import ctypes, sys, time\nctypes.CDLL(None).prctl(15, "
            f"{name!r}, 0, 0, 0)\nprint(1, flush=True)\ntime.sleep(60)",
        ],
        stdout=subprocess.PIPE,
    )
    try:
        stranger.stdout.readline()
        with open(f"/proc/{stranger.pid}/comm", "rb") as comm:
            assert comm.read().strip() == name, "cut amid a letter"
        robot.declare({"cam": {}})
        robot.request("cam")
        robot.wait(lambda: robot.active() == {"cam"})
        robot.wait(lambda: robot.loop.running.use().get("cam", (0.0, 0))[1] > 0)
        robot.release()
        robot.wait(lambda: robot.active() == set())
        assert not any("failed" in line for line in robot.lines)
    finally:
        stranger.kill()
        stranger.wait()


def test_the_end_of_a_run_that_began_while_nobody_looked_is_seen(tmp_path):
    engine = ProcessEngine("me", tmp_path)
    container = engine.create(
        "x", {"image": "x", "command": ["sleep", "100"]}, {"rorg.io/owner": "me", "rorg.io/service": "x"}
    )
    engine.start(container)
    stop, events = threading.Event(), []
    stream = engine.events(stop)
    assert next(stream) == ("", "")
    engine.stop(container, "SIGTERM", 5.0)
    engine.start(container)
    following = threading.Thread(target=lambda: [events.append(e) for e in stream], daemon=True)
    following.start()
    wait_for(lambda: len(events) >= 2)
    wait_for(lambda: (time.sleep(0.05), len(events))[1] == len(events))
    seen = len(events)
    os.killpg(engine.inspect(container).pid, 9)
    wait_for(lambda: len(events) > seen)
    stop.set()
    following.join(60)
    engine.remove(container)


# -- the machine -----------------------------------------------------------------------------------------------


def test_an_action_for_which_no_thread_can_be_had_is_tried_again(robot, monkeypatch):
    robot.declare({"aa": {}, "bb": {}})
    robot.settle()
    submit, failed = robot.loop.workers._pool.submit, []

    def scarce(*args):
        if len(failed) < 2:
            failed.append(args)
            raise RuntimeError("can't start new thread")
        return submit(*args)

    monkeypatch.setattr(robot.loop.workers._pool, "submit", scarce)
    robot.request("aa", "bb")
    robot.wait(lambda: robot.active() == {"aa", "bb"})
    assert len(failed) == 2


def test_an_action_after_which_the_engine_cannot_be_looked_at_has_an_outcome(robot, monkeypatch):
    robot.declare({"aa": {}})
    robot.settle()

    def broken(container: str) -> None:
        raise KeyError("State")

    with monkeypatch.context() as patch:
        patch.setattr(robot.loop.observer, "refresh", broken)
        robot.request("aa")
        robot.wait(lambda: any("> start aa" in line for line in robot.lines) or not robot.loop.running.memory.in_flight)
        wait_for(lambda: not robot.loop.running.memory.in_flight)
    robot.loop.observer.sync()
    robot.wait(lambda: robot.active() == {"aa"})


def test_a_full_disk_under_status_and_log_ends_nothing(robot, monkeypatch):
    robot.declare({"arm": {"always_on": True}})
    robot.wait(lambda: robot.active() == {"arm"})

    def full(*args, **more):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("rorg.daemon.publisher.write_atomic", full)
        patch.setattr(robot.loop.recorder, "say", full)
        before = robot.container("arm").incarnation
        robot.kill("arm")
        wait_for(lambda: robot.active() == {"arm"} and robot.container("arm").incarnation != before)
    assert robot.thread.is_alive()


def test_a_bug_in_one_pass_is_told_and_the_next_goes_on(robot, monkeypatch):
    robot.declare({"arm": {"always_on": True}})
    robot.wait(lambda: robot.active() == {"arm"})
    with monkeypatch.context() as patch:
        patch.setattr(robot.loop.ros.masters, "look", lambda situation: 1 / 0)
        robot.kill("arm")
        robot.wait(lambda: any("internal error" in line for line in robot.lines))
    robot.wait(lambda: robot.active() == {"arm"})
    robot.lines = [line for line in robot.lines if "internal error" not in line]


def test_manifests_are_followed_into_another_directory_of_the_same_name(robot, tmp_path):
    robot.declare({"aa": {"always_on": True}})
    robot.wait(lambda: robot.active() == {"aa"})
    robot.settle()
    write_tree(tmp_path / "next", {"aa": {"always_on": True}, "bb": {"always_on": True}})
    robot.tree.rename(tmp_path / "before")
    (tmp_path / "next").rename(robot.tree)
    robot.wait(lambda: robot.active() == {"aa", "bb"})
    text = (robot.tree / "services/bb.yaml").read_text()
    (robot.tree / "services/cc.yaml").write_text(text.replace("name: bb", "name: cc"))
    robot.wait(lambda: robot.active() == {"aa", "bb", "cc"})


@pytest.mark.parametrize(
    "label",
    [
        "",
        "{",
        "[]",
        "5",
        "null",
        "{}",
        '{"interlock": 5, "exclusive": {}, "conflicts": []}',
        "[" * 20000,
        '{"interlock": null, "exclusive": {"gpu": 1e999}, "conflicts": []}',
        '{"interlock": ["file"], "exclusive": {}, "conflicts": []}',
        '{"interlock": null, "exclusive": 5, "conflicts": []}',
    ],
)
def test_a_label_that_says_nothing_is_no_rule(label):
    assert rules_of(label) == Rules()
    declared_of(label)


def test_an_interlock_in_a_label_is_asked_at_a_reasonable_pace():
    for interval in ("NaN", "-1", "0", "1e300"):
        label = f'{{"interlock": ["file", "/x", {interval}], "exclusive": {{}}, "conflicts": []}}'
        assert 0.05 <= rules_of(label).interlock.interval <= 3600


# -- signals ---------------------------------------------------------------------------------------------------


def test_sighup_ends_no_rorg_that_follows_no_repository(tmp_path):
    """It looks at its manifests again, as daemons do."""
    rorg = RorgProcess(tmp_path, {"arm": {}}).start()
    try:
        wait_for(lambda: os.path.exists(rorg.socket()))
        client = rorg.client(patience=60)
        assert client.service("arm")["service"] == "arm"
        for _ in range(3):
            os.kill(rorg.process.pid, signal.SIGHUP)
            client.service("arm")
        write_tree(rorg.tree, {"arm": {}, "leg": {}})
        os.kill(rorg.process.pid, signal.SIGHUP)
        wait_for(lambda: {s["service"] for s in client.services()} >= {"arm", "leg"})
        assert rorg.process.poll() is None
    finally:
        rorg.close()
