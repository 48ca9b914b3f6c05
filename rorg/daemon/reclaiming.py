"""Pushing out what a paused service has in memory, where its manifest asks for that and the machine has swap."""

from __future__ import annotations

from rorg.core.observed import Container
from rorg.daemon.recorder import Recorder
from rorg.host.cgroups import reclaim
from rorg.model.catalog import Service
from rorg.model.units import format_memory


def reclaim_paused(service: Service | None, container: Container | None, recorder: Recorder) -> None:
    """Does so with the container of a service that was just paused, and says what came of it."""
    if not (service and service.idle.reclaim and container and container.state == "paused"):
        return
    try:
        freed = reclaim(container.pid)
    except OSError as error:
        recorder.event("reclaim-failed", f"memory of {service.name} stays: {error}", service=service.name)
    else:
        recorder.event(
            "reclaimed",
            f"{format_memory(freed)} of {service.name} pushed out to swap",
            service=service.name,
            bytes=freed,
        )
