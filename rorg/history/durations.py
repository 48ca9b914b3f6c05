"""Learns from the journal how long engine calls take, how long services take to start, resume and stop, and what they
use while they run."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from math import inf
from typing import Any

from rorg.model.units import parse_time
from rorg.model.workload import Behaviour, Distribution, Workload

KEPT = 20
"""Values that are kept of each: the newest ones."""
CALLS = frozenset({"create", "start", "pause", "resume", "stop", "remove"})
BEGINS = {"start": "start", "resume": "resume", "activate": "resume"}
"""Verb after which a service becomes ready -> field of a Behaviour."""


def with_use(workload: Workload, measured: Iterable[Mapping[str, Any]]) -> Workload:
    """The workload with the average cores and bytes of services that were measured, as the journal sums them up."""
    services = dict(workload.services)
    for one in measured:
        cpu, memory = Distribution((one["cpu"],)), Distribution((float(one["memory"]),))
        services[one["service"]] = replace(services.get(one["service"], Behaviour()), cpu=cpu, memory=memory)
    return replace(workload, services=services)


def learned_workload(name: str, entries: Iterable[Mapping[str, Any]]) -> Workload:
    """The measured durations in entries of the journal, which are in order. A simulation draws from them at random."""
    calls, times = defaultdict[str, list[float]](list), defaultdict[tuple[str, str], list[float]](list)
    begun: dict[str, tuple[str, float]] = {}
    ready: dict[str, float] = {}
    """Service -> when it became ready while no call was known: the loop may note that before the call's end."""
    for entry in entries:
        service, verb, state = (str(entry.get(key, "")) for key in ("service", "verb", "state"))
        if entry["kind"] == "done":
            begun.pop(service, None)
            if verb in CALLS:
                calls[verb].append(entry["seconds"])
            at = parse_time(entry["at"])
            if verb in BEGINS and ready.pop(service, -inf) >= at - entry["seconds"]:
                times[BEGINS[verb], service].append(0.0)
            elif verb in BEGINS:
                begun[service] = BEGINS[verb], at
            elif verb == "stop":
                times["stop", service].append(entry["seconds"])
        elif entry["kind"] == "state" and state != "running" and service in begun:
            what, since = begun.pop(service)
            if state == "ready":
                times[what, service].append(max(0.0, parse_time(entry["at"]) - since))
        elif entry["kind"] == "state" and state == "ready":
            ready[service] = parse_time(entry["at"])
    return _workload(name, calls, times)


def _workload(
    name: str, calls: Mapping[str, Sequence[float]], times: Mapping[tuple[str, str], Sequence[float]]
) -> Workload:
    """The engine's part of a stop is the shortest stop of all; the rest is the program's."""
    least = min(calls.get("stop", ()), default=0.0)
    services = {
        service: Behaviour(
            start=_spread(times.get(("start", service), ())),
            resume=_spread(times.get(("resume", service), ())),
            stop=_spread([one - least for one in times.get(("stop", service), ())]),
        )
        for service in sorted({service for _, service in times})
    }
    shown = {verb: Distribution(tuple(of[-KEPT:])) for verb, of in sorted(calls.items()) if verb != "stop"}
    return Workload(
        name, services, calls=shown | ({"stop": Distribution((least,))} if "stop" in calls else {}), probed=True
    )


def _spread(seconds: Sequence[float]) -> Distribution | None:
    return Distribution(tuple(seconds[-KEPT:])) if seconds else None
