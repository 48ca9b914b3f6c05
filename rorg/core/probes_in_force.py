"""Which probes tell of a service's present container. A changed manifest does not change what already runs: a container
that was proven keeps the probes that it was proven with while the changed edition has a container of its own, or has
failed. Otherwise a mistake in a probe would leave a good program without one that fits it.
"""

from __future__ import annotations

from dataclasses import replace

from rorg.core.desired import Desired
from rorg.core.diff import difference
from rorg.core.observed import Container
from rorg.core.update import Update
from rorg.model.catalog import Service
from rorg.model.probe import Probe


def fits(container: Container, name: str, desired: Desired) -> bool:
    """Return whether a container matches its manifest, so that no new one is needed."""
    if container.digest == desired.digests[name]:
        return True
    spec = desired.catalog.services[name].options
    return not difference(container, spec, desired.digests[name], desired.declared[name]).recreate


def with_probes_in_force(service: Service, update: Update, current: Container | None, desired: Desired) -> Service:
    """Return the service with the probes that its present container must answer: those it was proven with, unless they
    are the declared ones or the declared ones are being tried on it."""
    good = update.last_good
    if good is None or not is_as_proven(update, current) or (good.ready, good.live) == (service.ready, service.live):
        return service
    if current is None or (not update.failed and fits(current, service.name, desired)):
        return service
    return replace(service, ready=good.ready, live=good.live)


def is_as_proven(update: Update, current: Container | None) -> bool:
    """Return whether the present container was proven, or was made anew like the one that was and not on trial, and its
    manifest has changed since."""
    if current is None or update.baked == update.edition:
        return False
    good = update.last_good
    return current.id == update.well or (good is not None and current.digest == good.digest and not current.previous)


def is_ready_untried(service: Service, update: Update, current: Container | None) -> bool:
    """Return whether the `ready` probe is new to a container that was proven with another one. The probe may be wrong,
    so it takes no readiness away; that it denies says that the change failed."""
    good = update.last_good
    return good is not None and is_as_proven(update, current) and _differ(service.ready, good.ready)


def is_live_untried(service: Service, update: Update, current: Container | None) -> bool:
    """Return whether the `live` probe is new to a container that was proven with another one. It ends no run before it
    has held for a whole bake."""
    good = update.last_good
    return good is not None and is_as_proven(update, current) and _differ(service.live, good.live)


def _differ(one: Probe | None, other: Probe | None) -> bool:
    return one is not other and one != other
