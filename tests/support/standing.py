"""How changes stand."""

from __future__ import annotations

from rorg.core.standing import Standing, standing


def stands(virtual, good: bool = False) -> str:
    decision = virtual.sim.decision
    return standing(decision, Standing("good") if good else None).code
