"""Invariants of every plan. A violation is a bug in the planner: the pass is aborted before anything happens."""

from __future__ import annotations

from collections import Counter

from rorg.core.plan import Action, Plan
from rorg.core.situation import Situation

STATES = {
    "start": ("created", "exited"),
    "resume": ("paused",),
    "pause": ("running", "restarting"),
    "stop": ("running", "restarting", "paused"),
    "remove": ("created", "exited", "dead"),
    "signal": ("running",),
}
"""In which state of a container the engine takes a verb; other verbs go in any."""


def check(plan: Plan, situation: Situation) -> list[str]:
    """What is wrong with a plan, in words; empty for every plan that may be executed."""
    found: list[str] = []
    at_once = Counter(a.service for a in plan.actions if not a.after)
    found += [f"two actions at once for {name}" for name, count in sorted(at_once.items()) if count > 1]
    known = {c.id: c for c in situation.observed.containers}
    for action in plan.actions:
        if action.service in situation.memory.in_flight:
            found.append(f"a second action for {action.service} while one is under way")
        if action.container and action.container not in known:
            found.append(f"{action} touches a container that is not ours")
        elif action.container and known[action.container].service != action.service:
            found.append(f"{action} touches a container of {known[action.container].service}")
        if any(i >= action.index for i in action.after):
            found.append(f"{action} comes before what it must follow")
        if not action.after and action.container:
            state = known[action.container].state if action.container in known else ""
            if state not in STATES.get(action.verb, (state,)):
                found.append(f"{action} of a container that is {state}")
        found += _activation(action, situation)
        if not action.after and action.verb in ("start", "resume"):
            others = situation.observed.by_service().get(action.service, [])
            found += [
                f"{action} beside another active container of it"
                for c in others
                if c.active and c.id != action.container
            ]
        if situation.interlocks.get(action.service) and action.verb not in ("create", "rename"):
            found.append(f"{action} against its interlock")
    if plan.actions and not situation.observed.complete:
        found.append("actions on an incomplete observation")
    return found


def _activation(action: Action, situation: Situation) -> list[str]:
    services, name = situation.desired.catalog.services, action.service
    if name not in services or services[name].meta:
        ok = situation.removals and action.verb in ("stop", "remove")
        return [] if ok else [f"{action}, which no manifest declares"]
    if action.verb in ("start", "resume"):
        if name not in situation.wanted:
            return [f"{action}, which nobody wants"]
        unready = [
            n
            for n in services[name].needs
            if not services[n].meta
            and not action.after
            and not situation.memory.of(n).ready
            and not _completed(n, situation)
        ]
        if unready:
            return [f"{action} before {', '.join(unready)} is ready"]
    ends = action.verb in ("pause", "remove", "stop")
    if name in situation.wanted and ends and not (action.part_of or action.surplus):
        return [f"{action}, which is wanted"]
    return []


def _completed(name: str, situation: Situation) -> bool:
    current = next(iter(situation.observed.by_service().get(name, [])), None)
    service = situation.desired.catalog.services[name]
    return current is not None and current.exit_code == 0 and situation.memory.of(name).over(service, current)
