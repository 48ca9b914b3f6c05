"""How long programs of ROS take to stop."""

from __future__ import annotations

from robots import RealRobot

from rorg.history.journal import Filter

LONGEST = 2.0
"""Seconds that an end may take."""

ROUNDS = 3
"""Ends that are measured, for a machine that is busy with something else."""


def stop_seconds(robot: RealRobot, service: str) -> float:
    """How long its last stop took."""
    done = robot.loop.recorder.journal.select(Filter(kinds=frozenset({"done"}), services=frozenset({service})), 999)
    return next(entry["seconds"] for entry in reversed(done) if entry["verb"] == "stop")
