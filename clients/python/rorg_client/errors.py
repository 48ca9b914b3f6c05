"""The errors of calls: `cannot {what}: {cause}; try {remedy}`, or without "try" for a remedy "to do" something."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rorg_client.types import Readiness


class Error(Exception):
    """rorg refused, or did not answer."""

    def __init__(self, what: str, cause: str, remedy: str = "", code: str = "", status: int = 0) -> None:
        self.what, self.cause, self.remedy, self.code, self.status = what, cause, remedy, code, status
        advice = remedy[3:] if remedy.startswith("to ") else f"try {remedy}"
        super().__init__(f"{what}: {cause}" + (f"; {advice}" if remedy else ""))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.what, self.cause, self.remedy, self.code, self.status), dict(self.__dict__)


class Unreachable(Error):
    """rorg does not answer, or cannot answer now."""


class Forbidden(Error):
    """The caller lacks the permission."""


class NotFound(Error):
    """There is nothing of that name."""


class Refused(Error):
    """The call conflicts with something. `confirm`: the services that it would affect, if `force` would do it."""

    confirm: list[str] = []


class Invalid(Error):
    """The call is wrong in itself."""


class NotReady(Error):
    """Not ready in time; the cause says what is missing, `services` has the readiness of each."""

    services: dict[str, Readiness] = {}


_CODES = {
    "forbidden": Forbidden,
    "not-found": NotFound,
    "refused": Refused,
    "invalid": Invalid,
    "not-ready": NotReady,
    "unreachable": Unreachable,
    "busy": Unreachable,
    "too-many-requests": Unreachable,
    "ending": Unreachable,
}


def problem(status: int, text: bytes) -> Error:
    """The error in an answer."""
    try:
        told = json.loads(text)
    except ValueError:
        told = None
    if not isinstance(told, dict):
        told = {}
    kind = _CODES.get(str(told.get("code", "")), Unreachable if status == 503 else Error)
    found = kind(
        str(told.get("title", f"HTTP {status}")),
        str(told.get("cause", text.decode(errors="replace")[:200])),
        str(told.get("remedy", "")),
        str(told.get("code", "")),
        status,
    )
    if isinstance(found, NotReady) and isinstance(told.get("services"), dict):
        found.services = told["services"]
    if isinstance(found, Refused) and isinstance(told.get("confirm"), list):
        found.confirm = told["confirm"]
    return found


def invalid(what: str, cause: str, remedy: str = "") -> Invalid:
    return Invalid(what, cause, remedy, "invalid", 422)


def unreachable(where: str, error: BaseException) -> Unreachable:
    return Unreachable(f"cannot reach rorg on {where}", str(error) or type(error).__name__, "`rorg run`", "unreachable")
