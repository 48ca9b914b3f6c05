"""Groups of a robot as profiles of Compose."""

from __future__ import annotations

import re
from collections.abc import Mapping

from rorg.model.catalog import Catalog
from rorg.model.graph import closure

_PROFILE = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]+")
"""Names that Compose allows for profiles."""


def profiles(catalog: Catalog) -> Mapping[str, list[str]]:
    """Service -> its profiles: the groups that contain or need it. A service has none if it is active without a
    request, or if a service without a group needs it: `docker compose up` starts these."""
    services = catalog.services
    roots = [s.name for s in services.values() if s.always_on]
    roots += [member for request in catalog.requests for name in request.services for member in catalog.members(name)]
    groups = {g.name: closure(services, g.services) for g in catalog.groups.values() if _PROFILE.fullmatch(g.name)}
    grouped = {name for members in groups.values() for name in members}
    active = closure(services, [*roots, *(services.keys() - grouped)])
    by_service: dict[str, list[str]] = {}
    for group, members in sorted(groups.items()):
        for name in members - active:
            by_service.setdefault(name, []).append(group)
    return by_service
