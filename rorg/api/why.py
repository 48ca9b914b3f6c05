"""Why a service is active, or why it is not: who wants it, what keeps it out, and which command would let it in."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rorg.api.current import Current, missing
from rorg.api.views import requests
from rorg.core.admission import admit
from rorg.core.status import Status
from rorg.model.catalog import Catalog
from rorg.model.codes import VANISHED
from rorg.model.health import Health
from rorg.model.probe import Probe


def why_active(current: Current, name: str) -> list[dict[str, Any]]:
    """Why a service, or each of a group, is active, or why not. Raises Missing, and Refused if no
    manifests are in force."""
    catalog = current.catalog
    names = catalog.members(name) or ((name,) if name in current.statuses else ())
    if not names:
        current.check_in_force(f"find the service '{name}'")
        raise missing(name, {*catalog.services, *catalog.groups})
    return [_why(current, n) for n in names]


def _why(current: Current, name: str) -> dict[str, Any]:
    """The chain from a service to a root, who requests it, what needs it, and what it waits for."""
    status, catalog = current.statuses[name], current.catalog
    ready = status.condition("Ready")
    return {
        "service": name,
        "wanted": status.wanted,
        "health": str(status.health),
        "state": status.state,
        "chain": [
            {
                "service": link.service,
                "kind": link.cause.kind,
                "by": link.cause.by,
                "request": link.cause.request,
                "text": f"{_at(catalog, link.service)} ({link.cause})",
            }
            for link in status.chain
        ],
        "requests": [r for r in requests(current) if any(name in catalog.members(s) for s in r["services"])],
        "needed_by": sorted(s.name for s in catalog.services.values() if name in s.needs),
        "rivals": [
            {"service": rival, "text": " <- ".join(map(str, current.statuses[rival].chain))} for rival in status.rivals
        ],
        "remedies": list(_remedies(current, status)),
        "waits": [
            *([str(silence)] if (silence := current.decision.situation.observed.silence) else ()),
            *_suspended(current, status),
            *current.decision.plan.reasons().get(name, ()),
            *_failing_probes(current, status),
        ],
        "cautions": [
            *status.cautions,
            *([ready.message] if ready.reason == VANISHED else []),
            *_failed_change(current, status),
            *_spoiled(current, status),
        ],
    }


def _at(catalog: Catalog, name: str) -> str:
    """A service with its machine, if the robot has several."""
    machine = catalog.services[name].machine if name in catalog.services else ""
    return f"{name}@{machine}" if machine else name


def _suspended(current: Current, status: Status) -> Iterator[str]:
    """Why rorg does nothing about a service for which it has something to do."""
    decision = current.decision
    if decision.situation.suspended and any(a.service == status.service for a in decision.plan.actions):
        yield f"rorg is {decision.situation.suspended}"


def _failing_probes(current: Current, status: Status) -> Iterator[str]:
    """The probe that keeps a service from being ready, and the one that ended its last run, with what they ask."""
    ready, situation = status.condition("Ready"), current.decision.situation
    if not status.wanted or status.service not in situation.memory.progress:
        return
    probed, progress = situation.with_probes_in_force(status.service), situation.memory.of(status.service)
    if probed.ready and ready.reason in ("Probing", "Late") and ready.message:
        # The answers of several questions name them themselves.
        message = ready.message.removeprefix(str(probed.ready)).removeprefix(":").strip()
        yield f"`ready` ({_asked(probed.ready)}) fails: {message}"
    if probed.live and progress.hung and progress.hung == progress.incarnation:
        yield f"`live` ({_asked(probed.live)}) failed, which ended its last run"


def _asked(probe: Probe) -> str:
    return "all" if probe.parts else str(probe)


def _failed_change(current: Current, status: Status) -> Iterator[str]:
    """That its change failed, if the plan does not say so: of probes or files alone, nothing waits."""
    if status.update_failed and status.service not in current.decision.plan.reasons():
        yield f"its change failed: {status.update_failed}"


def _spoiled(current: Current, status: Status) -> Iterator[str]:
    """The change after which it is not well any more, which may be of a mounted file, so that the diff of its manifest
    shows nothing. A change that is not made because another one of its set failed is not to blame."""
    progress = current.decision.memory.of(status.service)
    update = progress.update
    fails = update.edition in update.failures or progress.exits > 0 or status.health is Health.DEGRADED
    if fails and update.baked and update.baked != update.edition:
        yield "it was well before its last change" + (", which `rorg rollback` undoes" if current.in_git else "")


def _remedies(current: Current, status: Status) -> Iterator[str]:
    """Commands after each of which a service that is kept out may be active. Only what a person asked for is
    suggested: a program would make its request again."""
    if any(_suspended(current, status)):
        yield "rorg suspend --end"
    if not status.health.kept_out:
        return
    name, catalog, kept = status.service, current.catalog, current.decision.memory.admitted
    for held in current.decision.holds:
        excluded = {n: why for n, why in kept.excluded.items() if n != held}
        if name in admit(catalog, kept.requests, excluded).wanted:
            yield f"rorg hold {held} --end"
    roots = {link.cause.request for rival in status.rivals for link in current.statuses[rival].chain}
    for request in kept.requests:
        person = request.requester in catalog.services and catalog.services[request.requester].meta
        if request.standing or not person or request.id not in roots:
            continue
        others = tuple(r for r in kept.requests if r is not request)
        if name in admit(catalog, others, kept.excluded).wanted:
            yield f"rorg release {request.id}"
