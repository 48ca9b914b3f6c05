"""The errors of rorg and the table of exit codes.

Every message reads "cannot X: why; try Y" or "cannot X: why; do Y", so that the reader knows what to do next.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import Any


class Exit(IntEnum):
    """Exit codes of every command."""

    OK = 0
    """OK, or no differences."""
    DIFFERENCES = 1
    """`rorg diff`: the plan is not empty. `rorg stop`: another request keeps the service wanted."""
    USAGE = 2
    """Wrong usage, or an invalid manifest or request."""
    UNREACHABLE = 3
    """The engine, or a running rorg, does not answer."""
    NOT_READY = 4
    """Applied, but not everything became ready in time."""
    REFUSED = 5
    """Lock held, stale plan, or a confirmation is missing. `rorg emulate`: a run is not valid."""
    INTERNAL = 70
    """A bug in rorg; an uncaught exception never exits 1."""


def advice(remedy: str) -> str:
    """The end of a message: "; try X" for a remedy such as a command or a name, and "; fix it" for "to fix it"; empty
    without one."""
    return ("; " + remedy.removeprefix("to ") if remedy.startswith("to ") else f"; try {remedy}") if remedy else ""


class RorgError(Exception):
    """An error that a person can fix: `cannot {what}: {why}`, and the advice to do so."""

    code = Exit.USAGE

    def __init__(self, what: str, why: str, remedy: str = "") -> None:
        self.what, self.why, self.remedy = what, why, remedy
        end = advice(remedy)
        super().__init__(f"cannot {what}: {why}{end.removeprefix('; ') if why.endswith(chr(10)) else end}")


class Invalid(RorgError):
    """A manifest, a request or an argument is wrong; nothing was changed."""


class Unreachable(RorgError):
    """The engine or the running rorg does not answer."""

    code = Exit.UNREACHABLE


class TimedOut(Unreachable):
    """It took too long."""


class Busy(Unreachable):
    """The running rorg cannot answer at the moment, but it or its successor soon will: ask again after `seconds`."""

    seconds = 1


class TooMany(Busy):
    """The caller asks for more than its share: ask again after `seconds`."""

    def __init__(self, what: str, why: str, remedy: str = "", seconds: int = 1) -> None:
        super().__init__(what, why, remedy)
        self.seconds = seconds


class NotReady(RorgError):
    """The request is accepted, but not everything was ready in time. `services` has the state of each."""

    code = Exit.NOT_READY

    def __init__(self, what: str, why: str, remedy: str = "", services: Mapping[str, Any] | None = None) -> None:
        super().__init__(what, why, remedy)
        self.services = services or {}


class Incomplete(NotReady):
    """An apply ended before everything was ready: `apply incomplete: {why}`, because part of it was done."""

    def __init__(self, why: str, remedy: str = "") -> None:
        super().__init__("complete the apply", why, remedy)
        self.args = (f"apply incomplete: {why}{advice(remedy)}",)


class Refused(RorgError):
    """Refused on purpose: lock held, confirmation missing, stale plan."""

    code = Exit.REFUSED


class StillWanted(RorgError):
    """The request is over, and the service goes on because something else asks for it."""

    code = Exit.DIFFERENCES


class Unconfirmed(Refused):
    """It needs a confirmation (`force`, `--yes`), because it would affect `services`."""

    def __init__(self, what: str, why: str, remedy: str = "", services: Sequence[str] = ()) -> None:
        super().__init__(what, why, remedy)
        self.services = tuple(services)


class Forbidden(Refused):
    """The caller does not have the permission."""


class Missing(Invalid):
    """Nothing has that name."""


class EngineError(RorgError):
    """The engine refused. `kind` is stable: missing_image, name_taken, missing_device, forbidden, unsupported, gone,
    conflict, spent, left_running, in_use, no_space, foreign or other."""

    code = Exit.NOT_READY

    def __init__(self, what: str, why: str, remedy: str = "", kind: str = "other") -> None:
        super().__init__(what, why, remedy)
        self.kind = kind
