"""Small defects to plant in a copy of rorg, each of which an invariant must catch.

`old` occurs once in the file. The features (worlds.py) describe the world in which the defect shows, and `steps` how
long a sequence it needs.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Defect:
    """One change of one file of rorg, and the invariants of which one must catch it."""

    name: str
    file: str
    old: str
    new: str
    caught_by: tuple[str, ...]
    services: int = 1
    features: tuple[tuple[str, ...], ...] = ()
    steps: int = 2
    path: tuple[tuple[tuple, float], ...] = ()
    """Steps that show it, if a search for them takes long."""


PLAN, FRESH = "the plan keeps its rules", "a kept pass decides as a fresh one"
READY, SERVED = "ready means ready", "all that is asked for and possible is ready"
REST, EMPTY, BOUNDED = "it comes to rest", "the plan is empty twice", "it converges in bounded passes"
RIVALS, TOGETHER = "nothing begins against rivals", "rivals never run together"
RULE, LEASES, KEPT = "the wanted follow the rule", "leases run out", "no request is lost or doubled"
GOOD, SAME, BAKE = (
    "the good stay until the next is proven",
    "the same is not created again",
    "a bake ends with evidence",
)
IDLE, RUN, TOLD = "the idle are as declared", "only the wanted run", "the wanted run or are explained"
NEEDS, ONE = "needs are ready first", "one container of a service"
REQUEST, THEN = (("request", 0), 150.0), (("request", 1), 150.0)
CHANGEOVER = (REQUEST, (("release", 0), 0.0), THEN)
NEED, RESTART = (("needs", "1", "0"),), (("needs", "1", "0"), ("restart", "1", "0"))
GPU, CONFLICT = (("gpu", "0", "1"),), (("conflict", "0", "1"),)
PROBE, ALWAYS = (("probe", "0"),), (("always", "0"),)

DEFECTS = (
    Defect(
        "needs are not wanted",
        "core/wanted.py",
        "        if need in catalog.services:\n",
        "        if need in ():\n",
        (RULE, SERVED, PLAN),
        2,
        NEED,
    ),
    Defect(
        "always_on is ignored",
        "core/wanted.py",
        "        if service.always_on:\n",
        "        if service.always_on is None:\n",
        (RULE,),
        1,
        ALWAYS,
    ),
    Defect(
        "a dead requester still wants",
        "core/requests.py",
        "    goes_on = any(c.incarnation == request.incarnation or c.brief for c in alive)\n",
        "    goes_on = True\n",
        ("no request outlives its requester",),
        2,
        (),
        3,
        (REQUEST, (("ask", 0, 1), 150.0), (("crash", 0), 150.0)),
    ),
    Defect(
        "a lease never ends",
        "core/requests.py",
        "            if lease.until <= now:\n",
        "            if lease.until < 0:\n",
        (LEASES,),
    ),
    Defect(
        "a lease begins again in every pass",
        "core/requests.py",
        "            if lease is None or lease.stamp != stamp or asleep or not observed.complete:\n",
        "            if True:\n",
        (LEASES,),
    ),
    Defect(
        "a lease ends early",
        "core/requests.py",
        "                lease = Lease(stamp, now + request.ttl)\n",
        "                lease = Lease(stamp, now + request.ttl / 2)\n",
        (KEPT,),
    ),
    Defect(
        "a repeated request is kept twice",
        "store/requests_document.py",
        "        if all(r.key != request.key for r in self.requests):\n",
        "        if True:\n",
        (KEPT,),
    ),
    Defect(
        "a release releases everything of the requester",
        "store/requests_document.py",
        "tuple(r for r in self.requests if r.key not in keys))",
        "tuple(r for r in self.requests if r.key[0] not in {k[0] for k in keys}))",
        (KEPT,),
        2,
        (),
        3,
        (REQUEST, THEN, (("release", 0), 150.0)),
    ),
    Defect(
        "a start does not wait for needs",
        "core/gates.py",
        "        reason = view.unready(need)\n        if not reason and need not in after",
        '        reason = ""\n        if not reason and need not in after',
        (PLAN, NEEDS),
        2,
        NEED,
    ),
    Defect(
        "a conflict holds nothing back",
        "core/gates.py",
        "        if view.active(other):\n",
        "        if False:\n",
        (RIVALS, TOGETHER),
        2,
        CONFLICT,
        3,
        CHANGEOVER,
    ),
    Defect(
        "one unit too many",
        "core/situation.py",
        "        if used <= self.capacity.get(resource, 1):\n            return []",
        "        if used <= self.capacity.get(resource, 1) + 1:\n            return []",
        (RIVALS, TOGETHER),
        2,
        GPU,
        3,
        CHANGEOVER,
    ),
    Defect(
        "a paused holder keeps its resource",
        "core/idle.py",
        "(container.alive and view.exclusive.contested(service))",
        "(container.alive and False)",
        (SERVED, RIVALS, PLAN),
        2,
        (*GPU, ("pause", "0")),
        3,
        (REQUEST, (("release", 0), 150.0), THEN),
    ),
    Defect(
        "needs end before those that need them",
        "core/gates.py",
        "        if view.active(dependant):\n",
        "        if False:\n",
        ("dependants end first",),
        2,
        NEED,
    ),
    Defect(
        "nothing lingers",
        "core/gates.py",
        "    if not idle.linger and not idle.min_active:\n        return None\n",
        "    return None\n",
        ("the idle linger",),
        1,
        (("linger", "0"),),
    ),
    Defect(
        "what is to be removed when idle stays",
        "core/reconcile.py",
        'return self.service.idle.action != "remove" and (',
        "return True and (",
        (IDLE,),
        1,
        (("remove", "0"),),
    ),
    Defect(
        "a call under way is not remembered",
        "core/dispatch.py",
        "in_flight={**memory.in_flight, **flights})",
        "in_flight=memory.in_flight)",
        ("one run of a service", FRESH, TOLD, PLAN, ONE, SAME, BOUNDED, REST),
    ),
    Defect(
        "an outcome is not noted",
        "core/dispatch.py",
        "        in_flight.pop(name, None)\n",
        "        in_flight.get(name)\n",
        (EMPTY, SERVED, REST),
    ),
    Defect(
        "only urgent work is begun",
        "core/dispatch.py",
        "        if slots[action.urgent] > 0:\n",
        "        if slots[action.urgent] > 0 and action.urgent:\n",
        (RUN, EMPTY, IDLE),
    ),
    Defect(
        "a stop of ours counts as a crash",
        "core/transitions.py",
        "    if run == progress.exited or run in progress.stopped:\n",
        "    if run == progress.exited:\n",
        (GOOD, "a stop is no crash"),
        1,
        (),
        3,
    ),
    Defect(
        "there is no back-off",
        "core/memory.py",
        "    return 0.0 if failures <= 1 else",
        "    return 0.0 if failures <= 1000 else",
        (BOUNDED,),
    ),
    Defect(
        "a delay is over immediately",
        "core/transitions.py",
        "now >= progress.running_since + service.ready.delay\n",
        "now >= progress.running_since\n",
        (READY,),
    ),
    Defect(
        "what ended stays ready",
        "core/transitions.py",
        "        return replace(progress, running_since=None, **UNANSWERED)\n",
        "        return replace(progress, running_since=None)\n",
        (READY,),
    ),
    Defect(
        "a new run is as ready as the last one",
        "core/transitions.py",
        "incarnation=current.incarnation, running_since=now, **UNANSWERED)",
        "incarnation=current.incarnation, running_since=now)",
        (READY,),
        path=(REQUEST, (("bounce", 0), 150.0)),
    ),
    Defect(
        "a failed probe counts",
        "core/transitions.py",
        '    if result.ok:\n        return replace(progress, ready=True, was_ready=True, probe="")\n',
        '    if True:\n        return replace(progress, ready=True, was_ready=True, probe="")\n',
        (READY,),
        1,
        PROBE,
    ),
    Defect(
        "a hung run goes on",
        "core/steps.py",
        "    if memory.hung == container.incarnation:\n",
        "    if not memory:\n",
        ("the hung are restarted",),
        1,
        PROBE,
    ),
    Defect(
        "a need that was restarted restarts nothing",
        "core/steps.py",
        "            and memory.counted_on.lost(need, container, current)\n",
        "            and False\n",
        ("runs follow those that they count on",),
        2,
        RESTART,
    ),
    Defect(
        "a need restarts what needs it for no reason",
        "core/steps.py",
        "            and memory.counted_on.lost(need, container, current)\n",
        "            and not memory.counted_on.lost(need, container, current)\n",
        ("a restart has its cause",),
        2,
        RESTART,
    ),
    Defect(
        "the previous container is not kept",
        "core/swap.py",
        "        if not container.started_at or container.state in",
        "        if container.started_at or container.state in",
        (GOOD, "a bad change leaves what ran", SERVED),
    ),
    Defect(
        "a bake ends at once",
        "core/rollout.py",
        "max(progress.well_since + service.update.bake, progress.update.since)",
        "max(progress.well_since, progress.update.since)",
        (BAKE,),
    ),
    Defect(
        "a bake ends without a look",
        "core/rollout.py",
        "    if answers is None or not evidence.looked_since(current, bake_end):\n",
        "    if answers is None:\n",
        (BAKE,),
    ),
    Defect(
        "what failed is not quarantined",
        "core/rollout.py",
        'error="", update=progress.update.quarantine(error))',
        'error="")',
        (REST, EMPTY, BOUNDED, "a bad change leaves what ran", SERVED),
    ),
    Defect(
        "a restart of rorg forgets what failed",
        "daemon/saved_memory.py",
        '        quarantined=_texts(known.get("quarantined")),\n',
        "",
        ("what failed is not tried again",),
        1,
        (),
        3,
    ),
    Defect(
        "the failed one stays in place",
        "core/swap.py",
        "        return self.denied or bool(self.failed)\n",
        "        return self.denied\n",
        (SERVED, "a bad change leaves what ran", REST, ONE),
    ),
    Defect(
        "every look finds a difference",
        "core/reconcile.py",
        "        more = (*nodes, *networks, *self.not_in_place(container, declared))\n",
        '        more = (*nodes, *networks, "image")\n',
        (SAME,),
    ),
    Defect(
        "a change is not seen",
        "core/reconcile.py",
        "for c, d in pairs if not d.recreate and c.id not in self.moved), None)",
        "for c, d in pairs), None)",
        ("what runs is what is declared",),
    ),
    Defect(
        "a container without a service's name is taken for one",
        "core/observed.py",
        "        if container.service:\n            by_service",
        "        if True:\n            by_service",
        ("only what is ours is touched", PLAN),
    ),
    Defect(
        "what depends is not planned again",
        "core/incremental.py",
        "changed | depending | locks",
        "changed | locks",
        (RUN, IDLE, FRESH, SERVED, PLAN, EMPTY, TOLD, NEEDS),
        2,
        NEED,
        path=((("request", 1), 0.45), (("release", 1), 150.0)),
    ),
    Defect(
        "what changes with time is not looked at again",
        "core/tracking.py",
        "    names.update(touched, kept.volatile)\n",
        "    names.update(touched)\n",
        (FRESH, SERVED, BAKE),
    ),
    Defect(
        "nobody wakes the loop",
        "core/decide.py",
        "(freed_at(memory.in_flight, now), due.next(now))",
        "(freed_at(memory.in_flight, now),)",
        (EMPTY, REST, SERVED, IDLE),
        2,
        NEED,
    ),
    Defect(
        "a call that never ends is forgotten",
        "core/planner.py",
        "        if flight:\n",
        "        if flight and self.s.now < flight.since + 1.0:\n",
        (PLAN, FRESH),
    ),
    Defect(
        "conflicts are not settled",
        "core/admission.py",
        "    return _conflict(catalog, active, priority) or _overbooked(catalog, active, priority)\n",
        "    return _overbooked(catalog, active, priority)\n",
        (SERVED, RIVALS, TOGETHER, "only rivals that fit are wanted"),
        2,
        CONFLICT,
        path=(THEN, (("always", 0), 150.0)),
    ),
    Defect(
        "exclusive resources are not settled",
        "core/admission.py",
        "    return _conflict(catalog, active, priority) or _overbooked(catalog, active, priority)\n",
        "    return _conflict(catalog, active, priority)\n",
        (SERVED, RIVALS, TOGETHER, "only rivals that fit are wanted"),
        2,
        GPU,
        path=(REQUEST, THEN),
    ),
)
