"""Which services are shed."""

from __future__ import annotations


def shed(robot) -> list[str]:
    return [s.service for s in robot.sim.memory.pressure.shed]
