"""HEALTH and SYNC of a service in `rorg get`."""

from __future__ import annotations

from rorg.core.diff import REPLICAS, difference
from rorg.core.observed import Container
from rorg.core.probes_in_force import is_live_untried, is_ready_untried
from rorg.core.situation import Situation
from rorg.model.catalog import Service
from rorg.model.codes import NO_IMAGE, VANISHED
from rorg.model.health import Health


def health_of(situation: Situation, name: str, ready: bool, reason: str, image: str | None) -> Health:
    """Return the health of a service. `ready` and `reason` are those of its condition Ready; `image` is the code of its
    waiting for an image."""
    if name not in situation.wanted:
        return kept_out(situation, name) or Health.IDLE
    progress = situation.memory.of(name)
    is_rejected = progress.update.is_rejected(situation.desired.digests[name])
    is_lost = reason == "NoContainer" and is_rejected  # what failed is not run again
    if image == NO_IMAGE or is_lost or (not ready and progress.stalled):
        return Health.DEGRADED
    if ready and not image:
        return Health.COMPLETED if reason == "Completed" else Health.HEALTHY
    return Health.DEGRADED if reason in ("Late", "Failed", "OutOfMemory", "NoDevice", VANISHED) else Health.PROGRESSING


def kept_out(situation: Situation, name: str) -> Health | None:
    """Return the health of a service that something wants but that must not be active; None for any other service."""
    if name not in situation.preempted:
        return None
    return Health.PREEMPTED if situation.rivals.get(name) else Health.WAITING


def is_synced(situation: Situation, service: Service, current: Container | None) -> bool:
    """Return whether a service has a container as declared, or none if it needs none. What lingers, crashes or waits in
    such a container is in sync."""
    if current is None:
        return not _must_exist(situation, service)
    name, desired = service.name, situation.desired
    found = difference(current, service.options, desired.digests[name], desired.declared[name])
    if found.recreate:
        return False
    if situation.engine.rename and current.name != service.container_name:
        return False
    # Pressure lowers CPU shares for a while. An engine without live updates can still set replicas back.
    live = [option for option in found.live if option != "cpu_shares" or name not in situation.measures.lowered]
    if live and (situation.engine.update or REPLICAS in live):
        return False
    update = situation.memory.of(name).update
    if is_ready_untried(service, update, current) or is_live_untried(service, update, current):
        return False  # only the probes changed, and they are on trial or failed
    contents = desired.contents.get(name, {})
    return service.on_change == "none" or not current.alive or not update.changed_content(current, contents)


def _must_exist(situation: Situation, service: Service) -> bool:
    """Return whether it has a container at all times, or is wanted now."""
    escalate = service.idle.escalate
    removed = service.idle.action == "remove" or (escalate is not None and escalate[1] == "remove")
    return service.name in situation.wanted or not removed
