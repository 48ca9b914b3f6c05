"""The standing of a revision of the manifests: whether it works, and so whether to go back to it or away from it.

Two more standings are known only to the keeper of revisions: `superseded` by a later one, and `refused` because it did
not load.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from rorg.core.decide import Decision
from rorg.core.plan import Action, Plan
from rorg.core.rollout import fits
from rorg.core.situation import Situation
from rorg.model.causes import causes
from rorg.model.codes import BLOCKED, IMAGE, NO_IMAGE

APPLYING, BAKING, GOOD, FAILED = "applying", "baking", "good", "failed"


@dataclass(frozen=True, slots=True)
class Standing:
    """`code` is one of:

    - applying: something remains to be done because of it;
    - baking: everything is done, but not all services have stayed well long enough;
    - good;
    - failed: one of its changes did not come up, and the services named in the reason run as before.

    `reason` is for people; "" for good.
    """

    code: str
    reason: str = ""


def standing(decision: Decision, good: bool = False) -> Standing:
    """Return the standing of the manifests in force. `good`: they were found good before; then only a change tried
    since can make them fail, because later trouble is not their fault.

    Wanted services must have stayed well for their bake; other services only need their containers. A failed change
    counts immediately, not only after it was undone. While an action is under way nothing else is checked, so this
    costs nothing while a robot starts.
    """
    situation = decision.situation
    undone = _undone(situation)
    if undone:
        return _told(undone)
    if good:
        return Standing(GOOD)
    if not situation.observed.complete:
        return Standing(APPLYING, "the engine does not answer")
    flights = (f.action for f in situation.memory.in_flight.values())
    doing = _first_of_tree(flights) or _first_of_tree(decision.plan.actions)
    if doing:
        return Standing(APPLYING, doing)
    plan = decision.plan
    failed = _failed(situation, plan)
    if failed:
        return _told(failed)
    waits = _waits(situation, plan)
    if waits:
        return Standing(APPLYING, waits)
    unbaked = [n for n in situation.desired.editions if _asked(situation, n) and not _baked(situation, n)]
    return Standing(BAKING, f"not yet known to stay well: {', '.join(unbaked)}") if unbaked else Standing(GOOD)


def _first_of_tree(actions: Iterable[Action]) -> str:
    return next((str(action) for action in actions if _of_tree(action)), "")


def _of_tree(action: Action) -> bool:
    """Return whether an action is due to the manifests. Services begin and idle because of requests, unless that is
    part of a change."""
    return not (action.operation.begins or action.operation.idles) or bool(action.part_of)


def _asked(situation: Situation, name: str) -> bool:
    return name in situation.wanted and name not in situation.prewarmed


def _baked(situation: Situation, name: str) -> bool:
    update = situation.memory.of(name).update
    return update.baked == update.edition


def _told(failed: Mapping[str, str]) -> Standing:
    return Standing(FAILED, "; ".join(map(str, causes(failed.items()))))


def _undone(situation: Situation) -> dict[str, str]:
    """Return services whose change is quarantined, each with the reason."""
    memory = situation.memory
    return {name: why for name in situation.desired.editions if (why := memory.of(name).update.failed)}


def _failed(situation: Situation, plan: Plan) -> dict[str, str]:
    memory = situation.memory
    failures = {w.service: w.reason for w in plan.waitings if w.code in (NO_IMAGE, BLOCKED)}
    return failures | {
        name: progress.error
        for name in situation.wanted
        if name in situation.desired.editions
        and name not in situation.prewarmed
        and (progress := memory.of(name)).stalled
        and name not in failures
        and not _baked(situation, name)
    }


def _waits(situation: Situation, plan: Plan) -> str:
    """Return what remains to be done and what it waits for."""
    waitings = [w for w in plan.waitings if w.code in (IMAGE, "deferred", "withheld")]
    if waitings:
        return f"{waitings[0].service}: {waitings[0].reason}"
    containers, reasons = situation.observed.by_service(), {w.service: w.reason for w in plan.waitings}
    for name in situation.desired.editions:
        existing = containers.get(name, ())
        if existing and not any(fits(c, name, situation.desired) for c in existing):
            return f"{name}: {reasons.get(name) or 'its container differs from its manifest'}"
        if _asked(situation, name) and not _baked(situation, name) and not (existing and existing[0].alive):
            return f"{name}: {reasons.get(name) or 'it does not run'}"
    return ""
