"""A robot that is taken down: whatever asks for it, every service is ceased and removed, in the order of its needs."""

from __future__ import annotations

from dataclasses import replace

from rorg.core.desired import Desired, desire
from rorg.model.catalog import Catalog, Idle

GONE = Idle(action="remove")


def taken_down(desired: Desired, last: Catalog | None) -> Desired:
    """What is desired then. Where no tree has been read, what the `last` good one declared tells the order."""
    catalog = desired.catalog if len(desired.catalog.services) > 1 else last or desired.catalog
    services = {
        name: service if service.meta else replace(service, always_on=False, idle=GONE)
        for name, service in catalog.services.items()
    }
    # A person has said that everything goes: nothing waits for another word.
    policy = replace(catalog.policy, removals="auto")
    # Nor does any network, or a volume where that was said.
    told = desired.catalog.fingerprint
    gone = replace(catalog, services=services, networks={}, volumes={}, requests=(), policy=policy, fingerprint=told)
    return desire(gone, contents=desired.contents)
