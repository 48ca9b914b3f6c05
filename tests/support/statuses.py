"""The statuses of services in a situation."""

from __future__ import annotations

from dataclasses import replace

from robots import VirtualRobot

from rorg.core.status import Statuses


def statuses(robot: VirtualRobot, **changes: object) -> Statuses:
    decision = robot.sim.decision
    return Statuses(replace(decision.situation, **changes), decision.plan, decision.holds)
