"""How what is remembered of a service changes with what is seen of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeGuard

from rorg.core.backoff import STABLE, delay
from rorg.core.memory import DEFAULT_GRACE, ProbeResult, Progress
from rorg.core.observed import Container
from rorg.core.operations import Start
from rorg.core.propagation import counts_on
from rorg.core.seen import Seen
from rorg.model.catalog import Service

UNANSWERED: dict[str, Any] = {
    "ready": False,
    "was_ready": False,
    "well_since": None,
    "probe": "",
    "answered": None,
    "denied": None,
}
"""Of a run that no probe has answered for yet."""
MARGIN = 4.0
"""Seconds that an engine takes to end what ignores its stop signal, beyond the grace."""


def advanced(step: Progress, service: Service, seen: Seen) -> Progress:
    """Takes note of what is wanted and observed of a service now: lingering, runs, exits, readiness, life."""
    current, now = seen.current(service.name), seen.now
    step = _fresh(_wanted(step, seen.wanted, now), current)
    step = _ceased(_run(step, current, now), current, now)
    counted_on = counts_on(step.counted_on, service, current, seen.containers, step.begun)
    step = step if counted_on is step.counted_on else replace(step, counted_on=counted_on, begun=None)
    if not seen.wanted and current is not None and current.state == "exited":
        step = step.with_stopped(current.incarnation)
    step = _doubt(step, service, None if seen.busy else current, now)
    if seen.wanted and not seen.busy:
        step = _ended_with_another(step, service, seen)
        step = _exit(step, current, now, seen.booted_at)
    step = _ready(step, service, seen.ready, now)
    step = _live(step, service, seen.live, now) if seen.wanted and not seen.busy else step
    step = _relied_on(step, service, seen.wanted, now)
    return _patient(_well(step, now)) if seen.unplugged else _well(step, now)


def _patient(step: Progress) -> Progress:
    """What goes wrong without its device is no failure to wait longer for: it starts as soon as that is back."""
    if not (step.exits or step.attempt(Start)):
        return step
    return replace(step.start_forgotten(), exits=0, error="")


def _wanted(step: Progress, is_wanted: bool, now: float) -> Progress:
    # Whoever asks for it gets a fresh start: what is missing for its container may be there by now.
    if is_wanted:
        return step if step.unwanted_since is None else replace(step, unwanted_since=None, attempts={}, error="")
    if step.unwanted_since is not None:
        return step
    return replace(step, unwanted_since=now, exits=0, exited="", attempts={}, error="")


def _fresh(step: Progress, current: Container | None) -> Progress:
    """Another container has no part in what the one before it did."""
    if not step.exited or current is None or step.exited.startswith(current.id[:12]):
        return step
    return replace(step, exits=0, exited="", attempts={}, error="")


def _run(step: Progress, current: Container | None, now: float) -> Progress:
    if current is None or current.state != "running":
        if step.running_since is None and not step.ready:
            return step
        return replace(step, running_since=None, **UNANSWERED)
    if step.running_since is None or step.incarnation != current.incarnation:
        return replace(
            step,
            incarnation=current.incarnation,
            running_since=now,
            **UNANSWERED,
        )
    if step.exits and step.hung != step.incarnation and now - step.running_since >= STABLE:
        return replace(step.start_forgotten(), exits=0, error="")
    return step


def _ceased(step: Progress, current: Container | None, now: float) -> Progress:
    if step.unwanted_since is None or current is None or current.active:
        return replace(step, ceased_since=None) if step.ceased_since is not None else step
    return replace(step, ceased_since=now) if step.ceased_since is None else step


def doubt_ends(step: Progress, service: Service) -> float | None:
    """When a run that was being stopped counts as one that goes on after all; None for one that was not."""
    grace = float((service.spec or {}).get("stop_grace_period", DEFAULT_GRACE))
    return None if step.doubted_since is None else step.doubted_since + grace + MARGIN


def _doubt(step: Progress, service: Service, current: Container | None, now: float) -> Progress:
    """Nothing is said of a run that may end at any moment, until its time to do so is over."""
    if current is None or not current.alive or current.incarnation not in step.stopped:
        return replace(step, doubted_since=None) if step.doubted_since is not None else step
    if step.doubted_since is None:
        return replace(step, doubted_since=now)
    if now < (doubt_ends(step, service) or 0.0):
        return step
    left = tuple(run for run in step.stopped if run != current.incarnation)
    return replace(step, stopped=left, doubted_since=None)


def _ended_with_another(step: Progress, service: Service, seen: Seen) -> Progress:
    """A namespace of processes ends with the run that it belongs to, and all in it are killed: that is no failure of
    theirs."""
    current = seen.current(service.name)
    if current is None or current.state != "exited":
        return step
    for name in (n for n, options in service.joins.items() if "pid" in options):
        other = seen.current(name)
        if other is None or not other.alive or step.counted_on.lost(name, current, other):
            return step.with_stopped(current.incarnation)
    return step


def _exit(step: Progress, current: Container | None, now: float, booted_at: str) -> Progress:
    if current is None or current.state != "exited" or not current.started_at:
        return step
    run = current.incarnation
    if run == step.exited or run in step.stopped:
        return step
    if current.started_at < booted_at and step.incarnation != run and step.begun is None:
        return step  # the machine's boot ended it; unless we saw or began it, and the clock was set since
    exits = step.exits + 1
    why = "out of memory" if current.oom_killed else f"exit code {current.exit_code}"
    step = replace(step, exits=exits, crashes=step.crashes + 1, exited=run)
    return step.start_after(now + delay(exits), f"ended with {why}")


def _ready(step: Progress, service: Service, found: ProbeResult | None, now: float) -> Progress:
    if step.running_since is None:
        return step
    if step.doubted_since is not None:
        return replace(step, ready=False) if step.ready else step
    if service.ready is None:
        return replace(step, ready=True, was_ready=True) if not step.ready else step
    if service.ready.delay is not None:
        # The same sum as the deadline that the loop sleeps for: a difference may round to just below it, for ever.
        return (
            replace(step, ready=True, was_ready=True)
            if not step.ready and now >= step.running_since + service.ready.delay
            else step
        )
    if not _fits(found, step):
        return step
    if found.ok and found.at != step.answered:
        step = replace(step, answered=found.at)
    if step.ready:
        return _still_ready(step, found, service.ready.failures)
    if found.ok:
        return replace(step, ready=True, was_ready=True, probe="")
    return replace(step, probe=found.message) if found.message != step.probe else step


def _relied_on(step: Progress, service: Service, wanted: bool, now: float) -> Progress:
    """Keeps the run that was ready under the last rorg until its probe answers this one, or is late."""
    if not wanted or step.running_since is None:
        run = ""
    elif step.ready:
        run = step.incarnation
    else:
        late = service.ready is not None and now >= step.running_since + service.ready.timeout
        unasked = step.relied_on == step.incarnation and not step.was_ready and not late
        run = step.relied_on if unasked else ""
    return step if run == step.relied_on else replace(step, relied_on=run)


def _still_ready(step: Progress, found: ProbeResult, failures: int) -> Progress:
    """Whether enough probes in a row said no for readiness to be lost; 0 failures: it is never lost."""
    if found.ok:
        return replace(step, probe="") if step.probe else step
    if failures and found.failures >= failures:
        return replace(step, ready=False, probe=found.message)
    return replace(step, denied=found.at, probe=found.message) if found.at != step.denied else step


def _live(step: Progress, service: Service, found: ProbeResult | None, now: float) -> Progress:
    """A service that was ready and does not answer any more counts as ended; the planner stops what is left of it.
    When it answers again before that could be done, nothing had happened."""
    if service.live is None or not _fits(found, step):
        return step
    if step.hung == step.incarnation:
        return (
            step
            if not found.ok
            else replace(
                step.start_forgotten(), hung="", exits=max(0, step.exits - 1), crashes=step.crashes - 1, error=""
            )
        )
    if found.failures < service.live.failures:
        return step
    exits = step.exits + 1
    step = replace(step, hung=step.incarnation, exits=exits, crashes=step.crashes + 1)
    return step.start_after(now + delay(exits), f"did not answer ({found.message})")


def _well(step: Progress, now: float) -> Progress:
    well = step.ready and step.hung != step.incarnation
    if well == (step.well_since is not None):
        return step
    return replace(step, well_since=now if well else None)


def _fits(found: ProbeResult | None, step: Progress) -> TypeGuard[ProbeResult]:
    """It is about this run: not of another incarnation, nor from before a resume."""
    return (
        found is not None
        and step.running_since is not None
        and found.incarnation == step.incarnation
        and found.at >= step.running_since
    )
