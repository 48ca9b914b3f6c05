"""Preview: what rorg would do if other manifests were declared. Nothing is executed."""

from __future__ import annotations

from dataclasses import replace

from rorg.core.decide import Decision, decide
from rorg.core.desired import Desired
from rorg.core.inputs import Inputs
from rorg.core.memory import Memory, ProbeResult, ProbeResults


def unlocked(desired: Desired, now: float) -> ProbeResults:
    """Return an allowing answer for every interlock. Interlocks are asked only before something is done."""
    return {(n, "interlock"): ProbeResult("", True, now) for n, s in desired.catalog.services.items() if s.interlock}


def preview(inputs: Inputs, memory: Memory, desired: Desired) -> Decision:
    """Decide as the last pass did, with other manifests and the present memory. Missing images hold nothing back,
    because they would be obtained first."""
    results = {**inputs.results, **unlocked(desired, inputs.now)}
    return decide(
        replace(
            inputs,
            desired=desired,
            memory=memory,
            results=results,
            removals=True,
            images={},
            load=None,
            asked={},
            cache=None,
        )
    )
