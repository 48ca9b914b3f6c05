"""What callers send, read: the same words from the API and from commands where no rorg serves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from rorg.api.body_models import PutRequest
from rorg.errors import Invalid
from rorg.model.catalog import Request
from rorg.model.units import parse_duration, parse_lease, parse_since, stamp

M = TypeVar("M", bound=BaseModel)
PARTS = ("body", "query", "path")


def unreadable(errors: Sequence[Mapping[str, Any]]) -> Invalid:
    """The error for what pydantic says of a call."""
    where = ".".join(str(p) for p in errors[0]["loc"] if p not in PARTS)
    why = f"{where or 'body'}: {errors[0]['msg']}"
    return Invalid("read the request", why, "what docs/reference/api.md says of it")


def read(model: type[M], body: Mapping[str, Any]) -> M:
    """A body as its model. Raises Invalid."""
    try:
        return model.model_validate(body)
    except ValidationError as error:
        raise unreadable(error.errors()) from error


def seconds_of(value: str | None, field: str, parse: Callable[[object], float] = parse_duration) -> float | None:
    """Seconds of a duration such as "10s"; None where none is given. Raises Invalid for what is none, and for 0."""
    if value is None:
        return None
    try:
        seconds = parse(value)
    except ValueError as error:
        raise Invalid("read the request", f"{field}: {error}") from error
    if not seconds:
        raise Invalid("read the request", f"{field}: must be more than 0", "10s, for instance")
    return seconds


def moment(text: str | None, field: str, now: float) -> str:
    """ISO 8601 in UTC of a time, or of so long before `now` (seconds since the epoch); empty without a text. Raises
    Invalid."""
    try:
        return stamp(parse_since(text, now)) if text else ""
    except ValueError as error:
        raise Invalid("read the request", f"{field}: {error}") from error


def request_of(id: str, requester: str, body: PutRequest, renewed: str = "") -> Request:
    """The request that a body asks for; a service that is named twice counts once. Raises Invalid for its lease."""
    return Request(
        id,
        requester,
        tuple(dict.fromkeys(body.services)),
        body.reason,
        priority=body.priority,
        ttl=seconds_of(body.ttl, "ttl", parse_lease),
        renewed=renewed,
    )
