"""Withheld removals: a typing error in a name must not stop anything. A removed service that a request, a need or a
group of the last good tree still names stays as it was declared until a person confirms its removal. So does everything
if a tree declares no service any more."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import TypeVar

from rorg.core.desired import Desired, desire_again
from rorg.core.observed import Observed
from rorg.model.catalog import DEVELOPER, Catalog, Group, Request, Service
from rorg.model.former import Former, Kept

T = TypeVar("T")
Withheld = Mapping[str, str]
"""Services and groups whose removal waits for confirmation -> the reason."""
EMPTIED = "the manifests no longer declare any service"


def emptied(catalog: Catalog) -> bool:
    """Return whether a tree was read that declares no service."""
    return len(catalog.services) <= 1 and bool(catalog.fingerprint)


def withhold(
    kept: Kept, desired: Desired, requests: Collection[Request], observed: Observed, confirmed: Collection[str]
) -> tuple[Kept, Desired, Withheld]:
    """Return the desired state including withheld services. Until a tree has been read, nothing is withheld."""
    catalog = desired.catalog
    if emptied(catalog):
        return _withhold_all(kept, desired, observed, confirmed)
    if len(catalog.services) <= 1:
        return kept, desired, {}
    former = {} if catalog.policy.removals == "auto" else _former(kept, catalog, observed, confirmed)
    former = _judged(former, catalog, requests, confirmed)
    held = {name: f for name, f in former.items() if f.withheld and name not in confirmed}
    reasons = {name: f.withheld for name, f in held.items()} | _unknown(former, catalog, requests, observed, confirmed)
    if not held:
        return Kept(catalog, former), desired, reasons
    merged = _merged(kept, desired, catalog, held)
    return Kept(catalog, former, merged), merged[2], reasons


def _withhold_all(
    kept: Kept, desired: Desired, observed: Observed, confirmed: Collection[str]
) -> tuple[Kept, Desired, Withheld]:
    """Keep the last non-empty tree in force, except for confirmed removals. Containers of unknown trees stay too."""
    nothing, last = desired.catalog, kept.catalog or desired.catalog
    if confirmed and not {*last.services, *last.groups, *kept.former}.isdisjoint(confirmed):
        last = replace(last, services=_without(last.services, confirmed), groups=_without(last.groups, confirmed))
    former = _without(kept.former, confirmed) if confirmed else kept.former
    declared: dict[str, Service | Group] = {**last.services, **last.groups}
    declared |= {name: f.what for name, f in former.items() if f.withheld}
    held = {n: Former(what, withheld=EMPTIED) for n, what in declared.items() if n not in nothing.services}
    present = (name for name in observed.by_service() if name not in confirmed)
    reasons = dict.fromkeys((*held, *present), EMPTIED)
    if not held:
        return Kept(last, former), desired, reasons
    requests = _naming(last.requests, held)
    base = replace(last, services=nothing.services, groups={}, requests=requests, fingerprint=nothing.fingerprint)
    merged = _merged(kept, desired, nothing, held, base)
    return Kept(last, former, merged), merged[2], reasons


def _without(mapping: Mapping[str, T], names: Collection[str]) -> dict[str, T]:
    return {name: value for name, value in mapping.items() if name not in names}


def _naming(requests: Iterable[Request], known: Collection[str]) -> tuple[Request, ...]:
    """Return standing requests, without names that are gone."""
    named = (replace(r, services=tuple(n for n in r.services if n in known)) for r in requests)
    return tuple(r for r in named if r.services and (r.requester == DEVELOPER or r.requester in known))


def _merged(
    kept: Kept, desired: Desired, catalog: Catalog, held: Mapping[str, Former], base: Catalog | None = None
) -> tuple[Catalog, Mapping[str, Former], Desired]:
    """Return the desired state with these services merged in, reused from the last pass if both inputs are the same."""
    merged = kept.merged
    if merged is not None and merged[0] is catalog and merged[1] == held:
        return merged
    return catalog, held, desire_again(_with(base or catalog, held), desired.contents)


def over(confirmed: Iterable[str], kept: Kept, catalog: Catalog, observed: Observed) -> tuple[str, ...]:
    """Return confirmations that no longer apply: what they name is gone or declared again."""
    if not observed.complete or (len(catalog.services) <= 1 and not emptied(catalog)):
        return ()
    there = observed.by_service()
    return tuple(
        n
        for n in confirmed
        if n in catalog.services or n in catalog.groups or (n not in there and n not in kept.former)
    )


def _former(kept: Kept, catalog: Catalog, observed: Observed, confirmed: Collection[str]) -> dict[str, Former]:
    """Return what was declared once, is not now, and still exists. Meta-services and groups have no container: they
    exist until their removal is confirmed."""
    former_services = {n: f for n, f in kept.former.items() if f.withheld or not _bodiless(f.what)}
    last = kept.catalog
    if last is not None and last is not catalog:
        held = [f.what for f in kept.former.values() if f.withheld and isinstance(f.what, Service)]
        declared: dict[str, Service | Group] = {**last.services, **last.groups}
        for name, what in declared.items():
            former_services[name] = Former(
                what,
                tuple(s.name for s in (*last.services.values(), *held) if name in s.needs),
                tuple(g.name for g in last.groups.values() if name in g.services),
            )
    containers = observed.by_service()
    return {
        name: f
        for name, f in former_services.items()
        if name not in catalog.services
        and name not in catalog.groups
        and (name not in confirmed if _bodiless(f.what) else name in containers or not observed.complete)
    }


def _bodiless(what: Service | Group) -> bool:
    return isinstance(what, Group) or what.meta


def _judged(
    former: Mapping[str, Former], catalog: Catalog, requests: Collection[Request], confirmed: Collection[str]
) -> dict[str, Former]:
    """Return former services with the reasons to withhold them. Services that only needed each other go together."""
    judged = dict(former)
    while judged:
        staying = {*catalog.services, *(n for n, f in judged.items() if f.withheld and n not in confirmed)}
        more = {
            name: replace(f, withheld=why)
            for name, f in judged.items()
            if not f.withheld and (why := _why(name, f, requests, staying))
        }
        if not more:
            break
        judged |= more
    return judged


def _why(name: str, former: Former, requests: Collection[Request], staying: Collection[str]) -> str:
    asked = _asked(name, requests)
    if isinstance(former.what, Group):
        return asked
    own = next((f"it has made request '{r.id}'" for r in requests if r.requester == name), "")
    if asked or (former.what.meta and own):
        return asked or own
    need = next((n for n in former.needed_by if n in staying), "")
    if need:
        return f"{need} needed it"
    if former.groups:
        return f"the group {former.groups[0]} named it"
    # Hardware moves, or stops holding, when its driver ends.
    return "it is a driver in use" if former.what.always_on and former.what.update.when == "confirmed" else ""


def _asked(name: str, requests: Iterable[Request]) -> str:
    return next((f"request '{r.id}' of {r.requester} names it" for r in requests if name in r.services), "")


def _unknown(
    former: Mapping[str, Former],
    catalog: Catalog,
    requests: Collection[Request],
    observed: Observed,
    confirmed: Collection[str],
) -> dict[str, str]:
    """Return containers of unknown trees that a request names."""
    if catalog.policy.removals == "auto":
        return {}
    there, named = observed.by_service(), {name for request in requests for name in request.services}
    return {
        name: _asked(name, requests)
        for name in sorted(named - catalog.services.keys())
        if name in there and name not in former and name not in confirmed
    }


def _with(catalog: Catalog, held: Mapping[str, Former]) -> Catalog:
    """Return the catalog including these, without references to what is gone."""
    services = {**catalog.services, **{n: f.what for n, f in held.items() if isinstance(f.what, Service)}}
    groups = {
        **catalog.groups,
        **{
            n: replace(f.what, services=tuple(m for m in f.what.services if m in services))
            for n, f in held.items()
            if isinstance(f.what, Group)
        },
    }
    for name in held:
        if name in services:
            old = services[name]
            services[name] = replace(
                old,
                needs=tuple(n for n in old.needs if n in services),
                restarts_with=tuple(n for n in old.restarts_with if n in services),
                joins={n: options for n, options in old.joins.items() if n in services},
            )
    return replace(catalog, services=services, groups=groups)
