"""The health of a service, as HEALTH in `rorg get`, in the API, in metrics and on the page."""

from __future__ import annotations

from enum import StrEnum


class Health(StrEnum):
    """How a service is doing. Clients read these words."""

    HEALTHY = "Healthy"
    """Wanted and ready."""
    PROGRESSING = "Progressing"
    """Wanted, and becoming ready; or its new image is being built or pulled."""
    DEGRADED = "Degraded"
    """Wanted and late, failed or Stalled; or its image or device is missing."""
    COMPLETED = "Completed"
    """Wanted, ran, and ended well."""
    PREEMPTED = "Preempted"
    """Something wants it, but active services that matter more have what it waits for."""
    WAITING = "Waiting"
    """Something wants it, but a hold, pressure, the budget or another machine keeps it from being active."""
    IDLE = "Idle"
    """Nothing wants it."""
    UNKNOWN = "Unknown"
    """The engine, or the machine that it belongs to, does not answer."""

    @property
    def kept_out(self) -> bool:
        """Whether something wants the service, but it must not be active."""
        return self in (Health.PREEMPTED, Health.WAITING)
