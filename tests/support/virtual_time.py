"""Steps in virtual time."""

from __future__ import annotations


def later(robot, seconds: float) -> None:
    """Virtual time goes on."""
    until = robot.now() + seconds
    robot.sim.at(until, lambda: None)
    robot.wait(lambda: robot.now() >= until, seconds + 1)
