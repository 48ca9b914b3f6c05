"""Room: which services must let go before a run of another one can go on.

A run needs room when it begins. It also needs room when its paused container is stopped: an engine can only deliver the
stop signal to a program that it resumes.
"""

from __future__ import annotations

from rorg.core.digest import rules_of
from rorg.core.plan import Waiting
from rorg.core.situation import View
from rorg.model.catalog import Service

Passage = tuple[tuple[str, ...], Waiting | None]
"""Services whose actions the step must follow, or what it waits for."""
FREE: Passage = (), None


def room(view: View, service: Service) -> Passage:
    """Return what a run of a service must follow or wait for: services that conflict with it, and users of its
    exclusive resources."""
    name, after = service.name, []
    for other in _rivals(view, name):
        if not (view.active(other) or view.runs(other)):
            continue
        if not view.has_actions(other):
            how = "being started" if view.s.starting(other) else "active"
            return (), Waiting(name, f"conflicts with {other}, which is {how}")
        after.append(other)
    for resource in service.exclusive:
        holders = view.exclusive.holders(service, resource, view.runs)
        if not all(view.has_actions(h) for h in holders):
            return (), Waiting(name, f"waits for {resource}, which {', '.join(holders)} still uses")
        after += holders
    return tuple(after), None


def _rivals(view: View, name: str) -> list[str]:
    """Return the services that conflict with one, by the manifests or by the label of a container without one."""
    undeclared = view.exclusive.undeclared
    named = rules_of(undeclared[name][0].rules).conflicts if name in undeclared else ()
    naming = [n for n, cs in undeclared.items() if name in rules_of(cs[0].rules).conflicts]
    return [*dict.fromkeys((*view.desired.conflicts.get(name, ()), *named, *naming))]
