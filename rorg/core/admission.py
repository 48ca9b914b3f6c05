"""Admission: who may be active when not everything that is wanted fits. Held and shed services, conflicts, exclusive
resources and the budget are settled here; a service that loses is *preempted*.

Admission depends only on the current requests and keeps no history. The same requests always give the same winners, so
services do not flap.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

from rorg.core.contests import Admission, settle_contests
from rorg.core.wanted import wanted
from rorg.model.catalog import Catalog, Request
from rorg.model.graph import closure
from rorg.model.units import format_memory


@dataclass(frozen=True, slots=True)
class Admitted:
    """An admission together with its inputs, kept so that the next pass can reuse it."""

    catalog: Catalog = Catalog()
    requests: tuple[Request, ...] = ()
    excluded: Mapping[str, str] = field(default_factory=dict)
    admission: Admission = Admission({})


def admission_for(
    last: Admitted, catalog: Catalog, requests: tuple[Request, ...], excluded: Mapping[str, str]
) -> Admitted:
    """Return the last admission if its inputs are the same, otherwise call admit(). With hundreds of requests admit()
    takes longer than the rest of a pass."""
    if last.catalog is catalog and last.excluded == excluded and last.requests == requests:
        return last
    return Admitted(catalog, requests, excluded, admit(catalog, requests, excluded))


def admit(catalog: Catalog, requests: Collection[Request], excluded: Mapping[str, str]) -> Admission:
    """Decide who may be active. `excluded` are services that must not be active, with the reason (held or shed).

    What needs a preempted service is preempted too. A meta-service never is: it has no container that could stop.
    """
    budget = catalog.policy.budget
    admission = settle_contests(catalog, tuple(requests), excluded)
    if budget is None or budget.over != "queue" or not over_budget(catalog, admission.wanted):
        return admission
    return _within_budget(catalog, requests, excluded)


def expected(catalog: Catalog, names: Collection[str]) -> tuple[float, int]:
    """Return (cores, bytes) that these services declare to use."""
    services = [catalog.services[n] for n in names if n in catalog.services]
    return sum(s.cpu for s in services), sum(s.memory for s in services)


def over_budget(catalog: Catalog, names: Collection[str]) -> str:
    """Return in words how the expected use exceeds the budget; "" if it fits."""
    budget = catalog.policy.budget
    if budget is None:
        return ""
    cpu, memory = expected(catalog, names)
    if budget.cpu is not None and cpu > budget.cpu + 1e-9:
        return f"{cpu:g} cores would exceed the budget of {budget.cpu:g}"
    if budget.memory is not None and memory > budget.memory:
        return f"{format_memory(memory)} would exceed the budget of {format_memory(budget.memory)}"
    return ""


def _within_budget(catalog: Catalog, requests: Collection[Request], excluded: Mapping[str, str]) -> Admission:
    """Admit requests that fit into the budget, higher priority first, then older; queue the others.

    Only used if the Policy says `over: queue`. Preempted services take no room.
    """
    waiting = sorted(requests, key=lambda r: -_priority(catalog, r))
    rivals = _rivals(catalog) | set(excluded)
    admitted_names = set(settle_contests(catalog, (), excluded).wanted)
    admitted: list[Request] = []
    queued: dict[str, str] = {}
    while (request := next((r for r in waiting if r.requester in admitted_names), None)) is not None:
        waiting.remove(request)
        asked = closure(catalog.services, [m for s in request.services for m in catalog.members(s)])
        # Contests cost time: settle them only if this request can take part in one.
        active = (
            set(settle_contests(catalog, (*admitted, request), excluded).wanted)
            if asked & rivals
            else admitted_names | asked
        )
        why = over_budget(catalog, active)
        if why and expected(catalog, active - admitted_names) != (0.0, 0):
            queued |= dict.fromkeys(sorted(active - admitted_names), f"waits for room: {why}")
        else:
            admitted.append(request)
            admitted_names = active
    # A request whose requester is not active takes no room: it stays admitted and has no effect.
    admission = settle_contests(catalog, (*admitted, *waiting), excluded)
    return replace(
        admission,
        asked=wanted(catalog, requests),
        preempted={
            **admission.preempted,
            **{n: why for n, why in queued.items() if n not in admission.wanted and n not in admission.preempted},
        },
    )


def _rivals(catalog: Catalog) -> set[str]:
    """Services that can preempt others or be preempted by them."""
    services = catalog.services.values()
    return {n for s in services if s.conflicts or s.exclusive for n in (s.name, *s.conflicts)}


def _priority(catalog: Catalog, request: Request) -> int:
    """Return the highest priority among a request and the services it names."""
    own = [catalog.services[m].priority for s in request.services for m in catalog.members(s)]
    return max([*own, request.priority or 0], default=0)
