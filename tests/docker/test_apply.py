"""`rorg apply` ends at once: 4 when a wanted service cannot succeed, 0 when only idle ones cannot."""

from __future__ import annotations

import os
import time

import commands
import pytest
from common import wait_for
from robots import RealRobot, write_tree
from rorg_process import RorgProcess

NOWHERE = {"image": "nowhere/none:1"}
CRASHES = {"command": ["sh", "-c", "exit 3"], "ready": {"delay": "10s"}}
"""Without a probe it would be ready for as long as it runs."""


@pytest.fixture
def robot(dockerd, tmp_path):
    found = RealRobot(tmp_path, "docker", dockerd.host)
    yield found
    found.close()


def apply(robot: RealRobot, *args: str) -> tuple[int, str, float]:
    """(exit code, what it said, seconds)."""
    began = time.monotonic()
    environment = {**os.environ, "RORG_STATE_DIR": str(robot.state.path), "RORG_ENGINE": "docker"}
    done = commands.run(["apply", str(robot.tree), "--yes", *args], environment)
    return done.returncode, done.stderr, time.monotonic() - began


@pytest.mark.parametrize("through", [False, True], ids=["alone", "through"])
@pytest.mark.parametrize("wait", [(), ("--wait",)], ids=["", "wait"])
def test_what_an_idle_service_lacks_holds_nothing_up(robot, through, wait):
    write_tree(robot.tree, {"base": {"always_on": True}, "spare": NOWHERE})
    if through:
        robot.start()
    code, said, seconds = apply(robot, *wait)
    assert (code, robot.states()) == (0, {"base": "running"}), said
    assert seconds < 20


@pytest.mark.parametrize("through", [False, True], ids=["alone", "through"])
@pytest.mark.parametrize("broken", [NOWHERE, CRASHES], ids=["image", "exit"])
def test_a_wanted_service_that_cannot_succeed_is_told_at_once(robot, through, broken):
    why = "cannot be pulled" if broken is NOWHERE else "exit code 3"
    write_tree(robot.tree, {"base": {"always_on": True}, "arm": {"always_on": True, **broken}})
    if through:
        robot.start()
    code, said, seconds = apply(robot, "--wait")
    assert code == 4, said
    assert "arm" in said, said
    assert why in said, said
    assert seconds < 20
    wait_for(lambda: robot.states()["base"] == "running", 30, "what can be done to be done")


@pytest.mark.parametrize("through", [False, True], ids=["alone", "through"])
@pytest.mark.smoke
def test_without_wait_failing_wanted_services_are_no_success(robot, through):
    write_tree(robot.tree, {"base": {"always_on": True}, "arm": {"always_on": True, **NOWHERE}})
    if through:
        robot.start()
        robot.wait(lambda: "cannot be pulled" in robot.waits("arm"))
    code, said, seconds = apply(robot)
    assert code == 4, said
    assert "cannot be pulled" in said, said
    assert seconds < 20


def test_a_replacement_that_cannot_be_made_is_told_and_leaves_what_runs(robot):
    write_tree(robot.tree, {"arm": {"always_on": True}})
    assert apply(robot, "--wait")[0] == 0
    before = robot.engine.api().inspect_container("arm")
    write_tree(robot.tree, {"arm": {"always_on": True, **NOWHERE}})
    code, said, _ = apply(robot, "--wait")
    assert code == 4, said
    assert "cannot be pulled" in said, said
    after = robot.engine.api().inspect_container("arm")
    assert (after["Id"], after["State"]["StartedAt"]) == (before["Id"], before["State"]["StartedAt"])


def test_what_a_person_holds_holds_nothing_up(robot):
    write_tree(robot.tree, {"base": {"always_on": True}, "spare": {}})
    robot.request("spare")
    robot.hold("spare", 600.0)
    code, said, seconds = apply(robot, "--wait")
    assert code == 0, said
    assert seconds < 20, said


@pytest.mark.slow
def test_without_wait_it_returns_though_requests_of_others_keep_rorg_busy(tmp_path):
    """Only what was planned has to be done."""
    stubborn = ["sh", "-c", "trap '' TERM INT; echo up; while :; do sleep 0.1; done"]
    slow = {"command": stubborn, "ready": {"log": "up"}, "container": {"stop_grace_period": "60s"}}
    robot = RorgProcess(tmp_path, {"arm": {"always_on": True}, "slow": slow}).start()
    try:
        client = robot.client(patience=30)
        client.wait("arm", timeout=30)
        request = client.request("slow", wait=30, ttl=None)
        write_tree(robot.tree, {"arm": {"always_on": True, "container": {"environment": {"N": "2"}}}, "slow": slow})
        request.release()
        wait_for(lambda: client.service("slow")["state"] == "stopping")
        environment = {**os.environ, "RORG_STATE_DIR": str(robot.state), "RORG_ENGINE": "process"}
        done = commands.run(["apply", str(robot.tree), "--yes", "--timeout", "30s"], environment)
        assert done.returncode == 0, done.stderr
        assert client.service("slow")["state"] == "stopping"
        assert client.service("arm")["sync"] == "Synced"
    finally:
        robot.close()
