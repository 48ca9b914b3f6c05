"""The state of the robot as JSON: the answers of the API, and what commands show if no rorg serves."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from rorg.api.current import Current
from rorg.core.decide import Decision
from rorg.core.desired import used_objects
from rorg.core.overview import Overview, proven_probes
from rorg.core.plan import Plan
from rorg.daemon.snapshot import request_json
from rorg.model.catalog import Catalog, Request
from rorg.model.graph import made_from, stands_on
from rorg.model.health import Health


def requests(current: Current) -> list[dict[str, Any]]:
    """All requests that count, standing ones first, with the seconds left of their leases."""
    leases = current.decision.memory.leases
    return [
        {**request_json(r), "expires_in": round(leases[r.key].until - current.clock, 3) if r.key in leases else None}
        for r in (*current.catalog.requests, *current.decision.settled.requests)
    ]


MOST_NAMED = 20


def summary(current: Current, about: Mapping[str, Any], machine: str) -> dict[str, Any]:
    """A robot in a few words. `about`: its tree and whether it is down."""
    tree, standing = about["tree"], about["tree"]["standing"] or {"code": "", "reason": ""}
    refused = str(tree["errors"][0]["message"]) if tree["errors"] else ""
    mine = [s for s in current.statuses.values() if s.state != "meta" and s.machine in ("", machine)]
    wanted = [s for s in mine if s.wanted]
    silence = current.decision.situation.observed.silence
    return {
        "robot": tree["robot"],
        "machine": machine,
        "revision": tree["revision"],
        "standing": "refused" if refused else standing["code"],
        "reason": refused or standing["reason"],
        "health": dict(Counter(str(s.health) for s in wanted)),
        "degraded": sorted(s.service for s in wanted if s.health is Health.DEGRADED)[:MOST_NAMED],
        "drift": sum(s.sync == "OutOfSync" for s in mine),
        "engine": str(silence or ""),
        "down": about["down"],
    }


def groups(catalog: Catalog) -> list[dict[str, Any]]:
    """The declared groups; their members are services."""
    return [
        {"name": g.name, "services": list(g.services), "description": g.description} for g in catalog.groups.values()
    ]


def graph(catalog: Catalog, live: Iterable[Request] = ()) -> dict[str, Any]:
    """Who needs and who requests whom, and who uses which network or volume, by the manifests and by live requests."""
    edges = {(s.name, n, "needs") for s in catalog.services.values() for n in s.needs}
    for request in (*catalog.requests, *live):
        edges |= {(request.requester, m, "requests") for s in request.services for m in catalog.members(s)}
    objects, uses, _ = used_objects(catalog)
    edges |= {(name, one, "uses") for name, subjects in uses.items() for one in subjects}
    return {
        "services": sorted(catalog.services),
        "objects": sorted(objects),
        "always_on": sorted(name for name, s in catalog.services.items() if s.always_on),
        "edges": [{"from": a, "to": b, "kind": kind} for a, b, kind in sorted(edges)],
    }


def image_graph(catalog: Catalog) -> dict[str, Any]:
    """The base images of the tree's images, and the services made from them."""
    below, made = stands_on(catalog.images), made_from(catalog)
    edges = sorted({(name, base) for name, bases in below.items() for base in bases})
    external = {base for _, base in edges} - set(below)
    return {
        "images": sorted(below),
        "external": sorted(external),
        "edges": [{"from": name, "to": base} for name, base in edges],
        "services": {name: made[name] for name in sorted({*below, *external} & set(made))},
    }


def images(catalog: Catalog) -> list[dict[str, Any]]:
    """The declared images; `context` is an absolute directory, or null if nothing is built."""
    below, made = stands_on(catalog.images), made_from(catalog)
    return [
        {
            "name": i.name,
            "context": i.context,
            "dockerfile": i.dockerfile,
            "bases": list(below[i.name]),
            "services": made.get(i.name, []),
        }
        for i in catalog.images.values()
    ]


def plan_forms(decision: Decision, plan: Plan, unified: bool, before: Catalog | None = None) -> dict[str, Any]:
    """A plan of a decision, in all its forms. `before` are the manifests in force, if these are others."""
    situation, catalog = decision.situation, decision.situation.desired.catalog
    overview = Overview(situation, plan, before.services if before else proven_probes(situation))
    return {
        "fingerprint": catalog.fingerprint,
        "withheld": sorted(situation.withheld),
        "probed": sorted(name for name, service in catalog.services.items() if service.ready),
        "empty": overview.empty,
        "text": overview.text(),
        "services": overview.as_json(),
        "unified": overview.unified() if unified else {},
        "suspended": situation.suspended,
        "plan": {**plan.as_json(), "summary": overview.summary()},
    }
