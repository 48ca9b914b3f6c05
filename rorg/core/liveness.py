"""The `live` probe of a service: what its answers say about a run, and when a new probe may end one."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeGuard

from rorg.core.desired import live_digest
from rorg.core.memory import ProbeResult, Progress, delay
from rorg.model.catalog import Service


def after_live(progress: Progress, service: Service, result: ProbeResult | None, now: float) -> Progress:
    """Count a service that stopped answering its `live` probe as ended; the planner then stops it. If it answers again
    before that, take the count back."""
    if service.live is None or not is_of_run(result, progress) or is_live_untried(progress, service):
        return progress
    if progress.hung == progress.incarnation:
        if not result.ok:
            return progress
        exits, crashes = max(0, progress.exits - 1), progress.crashes - 1
        return replace(progress.start_forgotten(), hung="", exits=exits, crashes=crashes, error="")
    if result.failures < service.live.failures:
        return progress
    exits = progress.exits + 1
    progress = replace(progress, hung=progress.incarnation, exits=exits, crashes=progress.crashes + 1)
    return progress.start_after(now + delay(exits), f"did not answer ({result.message})")


def is_live_untried(progress: Progress, service: Service) -> bool:
    """Return whether a `live` probe is new to a run that was proven without it. It may be wrong: until it has held for
    a whole bake, it ends nothing, and a failure says that the change failed."""
    update = progress.update
    if update.live in ("", live_digest(service)):
        return False
    return update.edition in update.quarantined or (
        update.edition != update.baked and progress.incarnation == update.earlier_run
    )


def denies_life(progress: Progress, service: Service, result: ProbeResult | None) -> bool:
    """Return whether a `live` probe has failed often enough to count for this run."""
    return service.live is not None and is_of_run(result, progress) and result.failures >= service.live.failures


def is_of_run(result: ProbeResult | None, progress: Progress) -> TypeGuard[ProbeResult]:
    """Return whether a result is about this run: the same incarnation, and from after the last resume."""
    return (
        result is not None
        and progress.running_since is not None
        and result.incarnation == progress.incarnation
        and result.at >= progress.running_since
    )
