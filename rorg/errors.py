"""The errors of rorg and the one table of exit codes.

Every message reads "cannot X: why; try Y", so that whoever meets it knows what to do next.
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
    """Lock held, stale plan, or a confirmation is missing."""
    INTERNAL = 70
    """A bug in rorg; an uncaught exception never exits 1."""


class RorgError(Exception):
    """An error that a person can act on: `cannot {what}: {why}; try {remedy}`."""

    code = Exit.USAGE

    def __init__(self, what: str, why: str, remedy: str = "") -> None:
        self.what, self.why, self.remedy = what, why, remedy
        super().__init__(f"cannot {what}: {why}" + (f"; try {remedy}" if remedy else ""))


class Invalid(RorgError):
    """A manifest, a request or an argument is wrong; nothing was changed."""


class Unreachable(RorgError):
    """The engine or the running rorg does not answer."""

    code = Exit.UNREACHABLE


class TimedOut(Unreachable):
    """It took longer than it may."""


class Busy(Unreachable):
    """The running rorg cannot answer at this moment and will soon, it or the next one: ask again after `seconds`."""

    seconds = 1


class TooMany(Busy):
    """The caller asks for more than its share: again after `seconds`."""

    def __init__(self, what: str, why: str, remedy: str = "", seconds: int = 1) -> None:
        super().__init__(what, why, remedy)
        self.seconds = seconds


class NotReady(RorgError):
    """What was asked for is applied, but not ready in time. `services` tells how each one is."""

    code = Exit.NOT_READY

    def __init__(self, what: str, why: str, remedy: str = "", services: Mapping[str, Any] | None = None) -> None:
        super().__init__(what, why, remedy)
        self.services = services or {}


class Refused(RorgError):
    """Refused on purpose: lock held, confirmation missing, stale plan."""

    code = Exit.REFUSED


class StillWanted(RorgError):
    """The request is over, and the service goes on because something else asks for it."""

    code = Exit.DIFFERENCES


class Unconfirmed(Refused):
    """It is only done when somebody says so once more (`force`, `--yes`): it would touch `services`."""

    def __init__(self, what: str, why: str, remedy: str = "", services: Sequence[str] = ()) -> None:
        super().__init__(what, why, remedy)
        self.services = tuple(services)


class Forbidden(Refused):
    """Whoever asked may not."""


class Missing(Invalid):
    """There is nothing of that name."""


class EngineError(RorgError):
    """The engine answered, and said no. `kind` is stable: missing_image, name_taken, missing_device,
    forbidden, unsupported, gone, conflict, other."""

    code = Exit.NOT_READY

    def __init__(self, what: str, why: str, remedy: str = "", kind: str = "other") -> None:
        super().__init__(what, why, remedy)
        self.kind = kind
