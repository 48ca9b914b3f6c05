"""`rorg down`: cease and remove every service, in the order of their needs, regardless of requests."""

from __future__ import annotations

from dataclasses import replace

from rorg.core.desired import Desired, desire
from rorg.model.catalog import Catalog, Idle

GONE = Idle(action="remove")


def teardown(desired: Desired, last: Catalog | None) -> Desired:
    """Return a desired state in which everything goes. If no tree could be read, the `last` good one gives the
    order."""
    catalog = desired.catalog if len(desired.catalog.services) > 1 else last or desired.catalog
    services = {
        name: service if service.meta else replace(service, always_on=False, idle=GONE)
        for name, service in catalog.services.items()
    }
    # `rorg down` is a person's order: nothing waits for another confirmation.
    policy = replace(catalog.policy, removals="auto")
    # No network is kept, and no volume if the person said so.
    fingerprint = desired.catalog.fingerprint
    gone = replace(
        catalog, services=services, networks={}, volumes={}, requests=(), policy=policy, fingerprint=fingerprint
    )
    return desire(gone, contents=desired.contents)
