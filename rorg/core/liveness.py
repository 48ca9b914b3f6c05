"""The `live` probe of a service: what its answers say about a run."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeGuard

from rorg.core.memory import ProbeResult, Progress, delay
from rorg.model.catalog import Service
from rorg.model.probe import Probe


def after_live(progress: Progress, service: Service, result: ProbeResult | None, now: float) -> Progress:
    """Count a service that stopped answering its `live` probe as ended; the planner then stops it. If it answers again
    before that, take the count back."""
    if service.live is None or not is_of_run(result, progress, service.live):
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


def denies_life(progress: Progress, service: Service, result: ProbeResult | None) -> bool:
    """Return whether a `live` probe has failed often enough to count for this run."""
    live = service.live
    return live is not None and is_of_run(result, progress, live) and result.failures >= live.failures


def is_of_run(result: ProbeResult | None, progress: Progress, probe: Probe) -> TypeGuard[ProbeResult]:
    """Return whether a result is about this run, and answers this probe: the same incarnation, and from after the last
    resume. The last result may be of an earlier manifest's probe."""
    return (
        result is not None
        and progress.running_since is not None
        and result.incarnation == progress.incarnation
        and (result.probe is probe or result.probe == probe)
        and result.at >= progress.running_since
    )
