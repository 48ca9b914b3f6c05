"""The standing of a revision of the manifests: whether it works, and so whether to go back to it or away from it.

Two more standings are known only to the keeper of revisions: `superseded` by a later one, and `refused` because it did
not load.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from rorg.core.decide import Decision
from rorg.core.plan import Action, Plan
from rorg.core.probes_in_force import fits
from rorg.core.situation import Situation
from rorg.model.causes import causes
from rorg.model.codes import BLOCKED, CONFIRM, DEFERRED, IMAGE, NO_IMAGE
from rorg.model.units import format_seconds

APPLYING, BAKING, UNTESTED, GOOD, FAILED = "applying", "baking", "untested", "good", "failed"


@dataclass(frozen=True, slots=True)
class Standing:
    """`code` is one of:

    - applying: something remains to be done because of it;
    - baking: everything is done, but not all services have stayed well long enough;
    - untested: everything is done and nothing failed, but services that it changed have not run since;
    - good: everything that it changed, and everything that is wanted, has run and stayed well;
    - failed: a service does not come up as declared, or ends again and again.

    `reason` is for people; "" for good. `failing`: the services because of which it failed.
    """

    code: str
    reason: str = ""
    failing: frozenset[str] = field(default=frozenset(), compare=False)


def standing(decision: Decision, before: Standing | None = None, changed: Collection[str] = ()) -> Standing:
    """Return the standing of the manifests in force.

    - `before`: their standing until now. A good revision stays good until a service fails. A failed one stays failed
      until everything has been proven: a release of a service, or a restart of rorg, repairs nothing.
    - `changed`: services that differ from the last good state of the manifests, or from the oldest on record.

    A failure counts immediately, not only after its change was undone. While an action is under way nothing else is
    checked, so this costs nothing while a robot starts.
    """
    situation = decision.situation
    failures = _known_failures(situation)
    if failures:
        return _failure(failures)
    if before and before.code == GOOD:
        return before
    now = _unfinished(decision) or _untested(situation, changed) or Standing(GOOD)
    return before if before and before.code == FAILED and now.code != GOOD else now


def _unfinished(decision: Decision) -> Standing | None:
    """Return why the manifests are not applied yet, or cannot be; None if they are, and all wanted services have stayed
    well for their bake."""
    situation, plan = decision.situation, decision.plan
    if not situation.observed.complete:
        return Standing(APPLYING, "the engine does not answer")
    flights = (f.action for f in situation.memory.in_flight.values())
    doing = _first_of_tree(flights) or _first_of_tree(plan.actions)
    if doing:
        return Standing(APPLYING, doing)
    if failures := {name: reasons[-1] for name, reasons in plan.reasons(NO_IMAGE, BLOCKED).items()}:
        return _failure(failures)
    if waits := _waits(situation, plan):
        return Standing(APPLYING, waits)
    unbaked = [n for n in situation.desired.editions if n in situation.wanted and not _baked(situation, n)]
    return _baking(situation, unbaked) if unbaked else None


def _baking(situation: Situation, names: Sequence[str]) -> Standing:
    """Return that services must stay healthy for a while. The longest time is shown: then all of them have."""
    services = situation.desired.catalog.services
    bake = max(services[name].update.bake for name in names)
    watched = f"being watched for {format_seconds(bake)}" if bake else "being watched"
    return Standing(BAKING, f"{watched}: {', '.join(names)}")


def _untested(situation: Situation, changed: Collection[str]) -> Standing | None:
    """Return that changed services have not run since, or that none has ever run; None if they have."""
    names = situation.desired.editions.keys()
    untried = [n for n in names if not _baked(situation, n)]
    if idle := [n for n in untried if n in changed]:
        return Standing(UNTESTED, f"not run since the change: {', '.join(idle)}")
    return Standing(UNTESTED, "no service has run yet") if names and len(untried) == len(names) else None


def _first_of_tree(actions: Iterable[Action]) -> str:
    return next((str(action) for action in actions if _of_tree(action)), "")


def _of_tree(action: Action) -> bool:
    """Return whether an action is due to the manifests. Services begin and idle because of requests, unless that is
    part of a change."""
    return not (action.operation.begins or action.operation.idles) or bool(action.part_of)


def _baked(situation: Situation, name: str) -> bool:
    update = situation.memory.of(name).update
    return update.baked == update.edition


def _failure(failures: Mapping[str, str]) -> Standing:
    return Standing(FAILED, "; ".join(map(str, causes(failures.items()))), frozenset(failures))


def _known_failures(situation: Situation) -> dict[str, str]:
    """Return services whose desired edition is known to fail, each with the reason."""
    updates = ((name, situation.memory.of(name).update) for name in situation.desired.editions)
    return {name: why for name, update in updates if (why := update.failed or update.broken)}


def _waits(situation: Situation, plan: Plan) -> str:
    """Return what remains to be done and what it waits for."""
    for name, reasons in plan.reasons(IMAGE, DEFERRED, CONFIRM, "withheld").items():
        return f"{name}: {reasons[0]}"
    containers, waits = situation.observed.by_service(), plan.reasons()
    for name in situation.desired.editions:
        existing = containers.get(name, ())
        if existing and not any(fits(c, name, situation.desired) for c in existing):
            return f"{name}: {waits[name][-1] if name in waits else 'its container differs from its manifest'}"
        if name in situation.wanted and not _baked(situation, name) and not (existing and existing[0].alive):
            return f"{name}: {waits[name][-1] if name in waits else 'it does not run'}"
    return ""
