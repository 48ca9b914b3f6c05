"""The robot without time-sharing: everything runs, all the time."""

from __future__ import annotations

from rorg.model.catalog import DEVELOPER, Catalog, Request
from rorg.model.graph import closure, conflicting, overbooked
from rorg.model.trace import Trace

ALL_ON = "all-on"
"""Id of the request for everything."""


def all_on_services(catalog: Catalog, trace: Trace) -> tuple[str, ...]:
    """Services that run when everything does. Of those that must not run together (conflicts, exclusive resources) the
    one stays out that the trace does not use; where it uses both, or neither, the one with the later name."""
    asked = (member for event in trace.events for name in event.services for member in catalog.members(name))
    used = closure(catalog.services, [*asked, *(n for n, s in catalog.services.items() if s.always_on)])
    found: set[str] = set()
    for name in sorted((n for n, s in catalog.services.items() if not s.meta), key=lambda n: (n not in used, n)):
        more = found | closure(catalog.services, [name])
        if not conflicting(catalog.services, more) and not overbooked(catalog, more):
            found = more
    return tuple(sorted(n for n in found if not catalog.services[n].meta))


def everything(catalog: Catalog, trace: Trace) -> Request:
    """The request that keeps them active."""
    return Request(ALL_ON, DEVELOPER, all_on_services(catalog, trace), "everything runs, for comparison")
