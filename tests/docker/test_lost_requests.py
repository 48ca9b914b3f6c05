"""What requests are told to have lost, and why, in virtual time."""

from __future__ import annotations

import pytest
from pressed_robots import POLICY, service
from robots import VirtualRobot

from rorg.core.service_events import losses, ready_runs
from rorg.history.journal import Filter


class Watched(VirtualRobot):
    """Looks at every decision, as the recorder does."""

    def __init__(self, folder) -> None:
        super().__init__(folder)
        self.ready: dict[str, str] = {}
        self.lost: list[tuple[str, str]] = []

    def wait(self, condition, seconds: float = 60.0) -> None:
        super().wait(lambda: (self.look(), condition())[1], seconds)

    def look(self) -> None:
        decision = self.sim.decision
        if decision is not None:
            before, self.ready = self.ready, ready_runs(decision)
            self.lost += [(loss.service, loss.cause) for loss in losses(before, self.ready, decision)]


@pytest.fixture
def robot(tmp_path):
    return Watched(tmp_path)


def test_what_pressure_sheds_is_lost_and_so_is_what_needs_it(robot):
    robot.declare(
        {
            "base": service(0.5, "1Gi", 90),
            "n0": service(0.3, "1Mi", 20),
            "top": {**service(0.3, "1Mi", 20), "needs": ["n0"]},
            "n1": service(0.9, "1Mi", 30),
        },
        policies=POLICY,
    )
    robot.request("base", "top", "n1")
    robot.wait(lambda: len(robot.active()) == 4)
    robot.sim.extra = (0.4, 0)
    robot.wait(lambda: len(robot.lost) >= 2, 120)
    assert set(robot.lost) == {("n0", "shed"), ("top", "shed")}


def test_what_is_released_is_not_lost_and_what_others_hold_is(robot):
    robot.declare({"aa": {}, "bb": {"needs": ["aa"]}, "cc": {}})
    robot.request("bb", id="one")
    robot.request("cc", id="two")
    robot.wait(lambda: robot.active() == {"aa", "bb", "cc"} and set(robot.ready) >= {"aa", "bb", "cc"})
    robot.release("two")
    robot.wait(lambda: robot.active() == {"aa", "bb"})
    assert not robot.lost
    robot.hold("aa", 60, "cleaning")
    robot.wait(lambda: robot.active() == set())
    assert set(robot.lost) == {("aa", "held"), ("bb", "held")}


def test_a_crash_is_told_once(robot):
    robot.declare({"aa": {}})
    robot.request("aa")
    robot.wait(lambda: "aa" in robot.ready)
    robot.kill("aa")
    robot.wait(lambda: robot.lost and "aa" in robot.ready)
    assert robot.lost == [("aa", "crashed")]


PROBED = {
    "command": ["python3", "-c", "import signal; signal.pause()"],
    "ready": {"exec": ["python3", "-c", ""], "interval": "50ms"},
    "container": {"stop_grace_period": "1s"},
}
CHANGED = {**PROBED, "container": {"stop_grace_period": "1s", "environment": {"NEW": "1"}}}


@pytest.mark.slow
@pytest.mark.parametrize("happens", ["changed", "killed", "held", "nothing"])
def test_a_loss_while_rorg_is_away_is_told_with_its_cause(real_robot, happens):
    robot = real_robot
    robot.declare({"aa": PROBED, "bb": {**PROBED, "needs": ["aa"]}})
    robot.request("bb")
    robot.wait(lambda: robot.loop.decision is not None and set(ready_runs(robot.loop.decision)) >= {"aa", "bb"})
    runs = {name: robot.run_of(name) for name in ("aa", "bb")}
    robot.stop()
    if happens == "killed":
        robot.kill("aa")
        robot.wait(lambda: robot.container("aa").state == "exited")
    if happens == "held":
        robot.hold("aa", 600, "cleaning")
    robot.declare({"aa": CHANGED if happens == "changed" else PROBED, "bb": {**PROBED, "needs": ["aa"]}})
    if happens == "held":
        robot.wait(lambda: not robot.active() & {"aa", "bb"})
    else:
        robot.wait(lambda: all(robot.loop.running.memory.of(name).ready for name in runs))
        robot.settle()
    told = robot.loop.recorder.journal.select(Filter(kinds=frozenset({"lost"})), 100)
    found = {(e["service"], e["cause"], e["incarnation"]) for e in told}
    first = {"changed": "replaced", "killed": "crashed", "held": "held", "nothing": ""}[happens]
    expected = {("aa", first, runs["aa"])} if first else set()
    expected |= {("bb", "held", runs["bb"])} if happens == "held" else set()
    assert found == expected
    assert len(told) == len(found), "each is told once"
    assert all(e["requests"] == ["developer/test"] for e in told)
