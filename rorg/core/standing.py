"""How a state of the manifests has done so far: whether it is to be gone back to, or from.

Whoever keeps revisions adds what is not seen here: `superseded` by a later one, and `refused` where it did not load.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from rorg.core.plan import Action, Plan
from rorg.core.rollout import fits
from rorg.core.situation import Situation
from rorg.model.codes import BLOCKED, IMAGE, NO_IMAGE

APPLYING, BAKING, GOOD, FAILED = "applying", "baking", "good", "failed"


@dataclass(frozen=True, slots=True)
class Standing:
    """`code`: applying (something is to be done on its word, or waits), baking (all is done, and not all services have
    stayed well for their time), good, or failed (a change of it does not come up: the services named in the reason are
    as they were before). `reason` is for people; empty for good."""

    code: str
    reason: str = ""


def standing(situation: Situation, plan: Plan, good: bool = False) -> Standing:
    """Of the manifests in force, after a pass. `good`: they were found good before. Then only a change that was not
    tried until now makes them fail: what else goes wrong later is not their doing.

    Wanted services must have stayed well once for their bake; of others it is enough that their containers are there.
    A change that has failed counts from then on, and not only when what it did has been undone.
    While something is under way nothing else is looked at, so it costs nothing while a robot comes up.
    """
    undone = _undone(situation)
    if undone:
        return _told(undone)
    if not situation.observed.complete:
        return Standing(GOOD) if good else Standing(APPLYING, "the engine does not answer")
    flights = situation.memory.in_flight.values()
    doing = next((str(a) for a in (*(f.action for f in flights), *plan.actions) if _of_tree(a)), "")
    if doing and not good:
        return Standing(APPLYING, doing)
    if good:
        return Standing(GOOD)
    failed = _failed(situation, plan)
    if failed:
        return _told(failed)
    waits = _waits(situation, plan)
    if waits:
        return Standing(APPLYING, waits)
    unbaked = [n for n in _services(situation) if _asked(situation, n) and not _baked(situation, n)]
    return Standing(BAKING, f"not yet known to stay well: {', '.join(unbaked)}") if unbaked else Standing(GOOD)


def _of_tree(action: Action) -> bool:
    """Whether it is done because of the manifests. A service begins or idles because of somebody's request, or its end,
    unless that is part of a change."""
    return not (action.operation.begins or action.operation.idles) or bool(action.part_of)


def _services(situation: Situation) -> list[str]:
    return list(situation.desired.editions)


def _asked(situation: Situation, name: str) -> bool:
    return name in situation.wanted and name not in situation.prewarmed


def _baked(situation: Situation, name: str) -> bool:
    update = situation.memory.of(name).update
    return update.baked == update.edition


def _told(failed: Mapping[str, str]) -> Standing:
    return Standing(FAILED, "; ".join(f"{name}: {why}" for name, why in failed.items()))


def _undone(situation: Situation) -> dict[str, str]:
    """Services whose change is in quarantine, each with why."""
    memory = situation.memory
    return {name: why for name in _services(situation) if (why := memory.of(name).update.failed)}


def _failed(situation: Situation, plan: Plan) -> dict[str, str]:
    memory = situation.memory
    found = {w.service: w.reason for w in plan.waitings if w.code in (NO_IMAGE, BLOCKED)}
    return found | {
        name: step.error
        for name in situation.wanted
        if name in situation.desired.editions
        and name not in situation.prewarmed
        and (step := memory.of(name)).stalled
        and name not in found
        and not _baked(situation, name)
    }


def _waits(situation: Situation, plan: Plan) -> str:
    """What of it is still to be done, and for what that waits."""
    told = [w for w in plan.waitings if w.code in (IMAGE, "deferred", "withheld")]
    if told:
        return f"{told[0].service}: {told[0].reason}"
    containers, reasons = situation.observed.by_service(), {w.service: w.reason for w in plan.waitings}
    for name in _services(situation):
        there = containers.get(name, ())
        if there and not any(fits(c, name, situation.desired) for c in there):
            return f"{name}: {reasons.get(name) or 'its container is not as declared'}"
        if _asked(situation, name) and not _baked(situation, name) and not (there and there[0].alive):
            return f"{name}: {reasons.get(name) or 'it does not run'}"
    return ""
