"""An engine that goes away takes programs along. A change that was on trial then is not to blame."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest
from common import wait_for
from forwarder import Forwarder
from robots import Daemon, RealRobot, VirtualRobot, write_tree
from trials import NEW, OLD, edition, on_trial, running, runs
from updates import later

from rorg.core.memory import STALLED_AFTER


def outage(virtual: VirtualRobot) -> None:
    """The engine does not answer for ten seconds; a minute passes after them."""
    virtual.sim.faults.unreachable = True
    later(virtual, 10)
    virtual.sim.faults.unreachable = False
    later(virtual, 60)


@pytest.mark.parametrize(("before", "tried"), [(3, True), (60, False)])
def test_a_change_that_fails_right_before_an_outage_is_tried_again(tmp_path, before, tried):
    virtual = VirtualRobot(tmp_path)
    digest = on_trial(virtual)
    virtual.kill("nav")
    later(virtual, before)
    assert "its change failed" in virtual.waits("nav")
    outage(virtual)
    assert (runs(virtual) == digest) == tried


def test_a_change_that_fails_for_its_own_reasons_is_tried_once_more(tmp_path):
    virtual = VirtualRobot(tmp_path)
    digest = on_trial(virtual)
    virtual.sim.faults.bad[digest] = "exit"
    virtual.kill("nav")
    later(virtual, 3)
    outage(virtual)
    assert runs(virtual) not in ("", digest)
    begun = sum(verb == "start" and service == "nav" for _, verb, service in virtual.sim.engine.calls)
    assert begun <= 5, "two trials, and the way back twice"


def test_a_restart_of_docker_does_not_undo_a_change(tmp_path, dockerd):
    if not hasattr(dockerd, "folder"):
        pytest.skip("somebody else runs this engine")
    robot = RealRobot(tmp_path, "docker", dockerd.host)
    write_tree(robot.tree, edition(OLD))
    daemon = Daemon(robot)
    daemon.start()
    client = robot.client(patience=60.0)
    client.wait("nav", timeout=60)
    old = running(robot)
    write_tree(robot.tree, edition(NEW))
    new = wait_for(lambda: running(robot) not in ("", old) and running(robot), 60, "the new edition to run")
    dockerd.stop()
    dockerd.start()
    wait_for(lambda: running(robot) == new, 90, "the new edition to run again")
    client.wait("nav", timeout=60)
    assert client.service("nav")["health"] == "Healthy"
    daemon.stop()
    robot.close()


@pytest.mark.parametrize(
    ("restart", "code", "again"),
    [("never", 0, 0), ("never", 1, 0), ("on-failure", 0, 0), ("on-failure", 1, 1), ("always", 0, 1)],
)
def test_what_ends_for_good_during_an_outage_is_not_run_again(tmp_path, restart, code, again):
    """A program that moves the arm once must not move it twice because Docker was away."""
    virtual = VirtualRobot(tmp_path)
    virtual.declare({"homing": {"always_on": True, "restart": restart}})
    virtual.settle()
    later(virtual, 60)
    virtual.sim.faults.unreachable = True
    later(virtual, 5)
    virtual.sim.engine.kill(virtual.sim.engine.list()[0].id, code)
    virtual.sim.faults.unreachable = False
    later(virtual, 60)
    assert starts(virtual, "homing") == 1 + again


@pytest.mark.parametrize(("restart", "again"), [("never", 0), ("on-failure", 1), ("always", 1)])
def test_a_change_that_failed_before_an_outage_is_tried_again_only_if_it_restarts(tmp_path, restart, again):
    virtual = VirtualRobot(tmp_path)
    task = {"restart": restart, "update": {"bake": "2m"}}
    virtual.declare({"homing": {**task, "always_on": True, "container": {"environment": OLD}}})
    virtual.settle()
    virtual.declare({"homing": {**task, "always_on": True, "container": {"environment": NEW}}})
    digest = virtual.sim.desired.digests["homing"]
    virtual.wait(lambda: runs(virtual) == digest)
    virtual.kill("homing")
    later(virtual, 3)
    outage(virtual)
    assert (runs(virtual) == digest) == bool(again)


def starts(virtual: VirtualRobot, name: str) -> int:
    return sum(verb == "start" and service == name for _, verb, service in virtual.sim.engine.calls)


def test_calls_that_are_cut_off_while_docker_restarts_are_no_reason_to_give_up(tmp_path, dockerd):
    """As at the end of a restart: it answers already, and ends connections of calls. Who waits goes on waiting."""
    line = Forwarder(dockerd.host)
    robot = RealRobot(tmp_path, "docker", line.host, with_server=True)
    try:
        robot.declare({"arm": {}})
        robot.wait(lambda: robot.states() == {"arm": "created"})
        line.reset = rb"/containers/[^/]+/start"
        robot.request("arm")
        client = robot.client()
        with ThreadPoolExecutor() as pool:
            waiting = pool.submit(client.wait, "arm", timeout=40.0)
            robot.wait(lambda: line.resets >= STALLED_AFTER + 1 or waiting.done())
            assert not waiting.done(), waiting.result()
            assert client.service("arm")["health"] == "Progressing"
            line.reset = b""
            assert waiting.result(60)["arm"]["ready"]
        assert not [text for text in robot.lines if "stalled" in text]
    finally:
        line.reset = b""
        robot.close()
        line.close()
