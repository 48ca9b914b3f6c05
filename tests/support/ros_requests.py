"""Requests through ROS, and who holds them."""

from __future__ import annotations

import os

import commands
from robots import RealRobot

PAUSE = {"idle": {"action": "pause"}}

CYCLES = int(os.environ.get("RORG_TEST_ROS_CYCLES", "30"))
"""Requests and releases through ROS, back to back."""


def held(robot: RealRobot) -> dict[str, list[str]]:
    """Requester -> what is requested."""
    found: dict[str, list[str]] = {}
    for request in robot.requests():
        found.setdefault(request.requester, []).extend(request.services)
    return found


class Rorg:
    """The program itself, so that it can be ended as it is on a robot."""

    def __init__(self, robot: RealRobot) -> None:
        self.robot = robot
        self.log = robot.state.path.parent / "run.log"
        self.start()

    def start(self) -> None:
        with self.log.open("ab") as log:
            words = ["run", self.robot.tree, "--state-dir", self.robot.state.path, "--engine", "docker"]
            self.process = commands.Forked(words, stdout=log, stderr=log)

    def end(self, kill: bool = False) -> None:
        (self.process.kill if kill else self.process.terminate)()
        self.process.wait(60)
