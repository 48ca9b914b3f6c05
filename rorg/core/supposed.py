"""What would be done if something else were declared: a plan that is only shown."""

from __future__ import annotations

from dataclasses import replace

from rorg.core.decide import Decision, decide
from rorg.core.desired import Desired
from rorg.core.inputs import Inputs
from rorg.core.memory import Memory, ProbeResult, ProbeResults


def unlocked(desired: Desired, now: float) -> ProbeResults:
    """The word of each interlock. It is asked when something is done; what is only shown does not wait for it."""
    return {(n, "interlock"): ProbeResult("", True, now) for n, s in desired.catalog.services.items() if s.interlock}


def suppose(inputs: Inputs, memory: Memory, desired: Desired) -> Decision:
    """What the pass with these inputs, and what is remembered since, would decide if this were declared. Images that
    are not there are no reason to wait: they would be had first."""
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
