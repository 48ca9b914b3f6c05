"""What requests are told to have lost, and why, in virtual time."""

from __future__ import annotations

import pytest
from robots import VirtualRobot
from test_pressure import POLICY, service

from rorg.core.losses import losses, ready_runs


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
