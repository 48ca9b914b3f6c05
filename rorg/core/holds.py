"""How long holds and suspensions last. A person gives a duration, and the clock may be set while it runs: a robot
without a battery boots in 1970, and NTP sets its clock minutes later. So the end is kept by the time since the boot."""

from __future__ import annotations

from dataclasses import dataclass, replace

from rorg.model.catalog import Hold

CLOCK_SET = 1577836800.0
"""The beginning of 2020: a clock that shows an earlier time has not been set since the machine was switched on."""
STEP = 1.0
"""Seconds by which the clock has been set if the end of a hold is off by more; less may be a clock that is slewed."""


@dataclass(frozen=True, slots=True)
class Moment:
    """A moment by all clocks of a machine: seconds since the epoch, by the clock that may be set; seconds of the
    monotonic clock, which begins with each boot; and the id of the boot."""

    wall: float
    uptime: float
    boot: str


def begin_hold(at: Moment, seconds: float, reason: str = "") -> Hold:
    """Return a hold for so many seconds."""
    return Hold(at.wall + seconds, reason, seconds, at.uptime + seconds, at.boot)


def seconds_left(hold: Hold, now: Moment) -> float:
    """Return for how many more seconds a hold lasts; none of them are left if that is not positive.

    After a reboot only the clock tells how much time went by. A hold then lasts for its whole duration at most, and
    exactly that if the clock had not been set when it began. If a person wrote only a time, the clock decides.
    """
    if hold.duration is None:
        return hold.until - now.wall
    if hold.boot == now.boot:
        return hold.uptime - now.uptime
    if hold.until - hold.duration < CLOCK_SET:
        return hold.duration
    return min(hold.duration, hold.until - now.wall)


def adjusted(hold: Hold, now: Moment) -> Hold:
    """Return the hold with its end by the present clock and boot; the same object if that has not changed."""
    left = seconds_left(hold, now)
    if hold.duration is None or (hold.boot == now.boot and abs(now.wall + left - hold.until) < STEP):
        return hold
    return replace(hold, until=now.wall + left, uptime=now.uptime + left, boot=now.boot)
