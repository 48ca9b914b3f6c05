"""What callers send: bodies as pydantic models, which are in the OpenAPI document too, and how they are read. Commands
read them in the same way if no rorg serves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from rorg.errors import Invalid
from rorg.model.catalog import HIGHEST_PRIORITY, Request
from rorg.model.units import parse_duration, parse_lease, parse_since, stamp

M = TypeVar("M", bound=BaseModel)
PARTS = ("body", "query", "path")


def unreadable(errors: Sequence[Mapping[str, Any]]) -> Invalid:
    """The error for what pydantic reports about a call."""
    where = ".".join(str(p) for p in errors[0]["loc"] if p not in PARTS)
    why = f"{where or 'body'}: {errors[0]['msg']}"
    return Invalid("read the request", why, "the form in docs/reference/api.md")


def read(model: type[M], body: Mapping[str, Any]) -> M:
    """A body as its model. Raises Invalid."""
    try:
        return model.model_validate(body)
    except ValidationError as error:
        raise unreadable(error.errors()) from error


def seconds_of(value: str | None, field: str, parse: Callable[[object], float] = parse_duration) -> float | None:
    """Seconds of a duration such as "10s"; None without one. Raises Invalid for a mistake, and for 0."""
    if value is None:
        return None
    try:
        seconds = parse(value)
    except ValueError as error:
        raise Invalid("read the request", f"{field}: {error}") from error
    if not seconds:
        raise Invalid("read the request", f"{field}: must be more than 0", "a duration such as 10s")
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


Short = Annotated[str, Field(max_length=500)]
ServiceName = Annotated[str, Field(min_length=1, max_length=64)]


class Body(BaseModel):
    """What callers send; unknown fields are refused."""

    model_config = ConfigDict(extra="forbid")


class PutRequest(Body):
    """The requested services."""

    services: Annotated[list[ServiceName], Field(min_length=1, max_length=300)]
    reason: Short = ""
    priority: Annotated[int, Field(ge=0, le=HIGHEST_PRIORITY)] | None = None
    ttl: Annotated[str, Field(max_length=20)] | None = Field(default=None, description="Lease, such as 10s.")


Force = Annotated[bool, Field(description="Even if it stops a driver or other services.")]


class SuspendBody(Body):
    """How long, and why."""

    duration: Annotated[str, Field(max_length=20)] = Field(description="How long, such as 10m.")
    reason: Short = ""


class HoldBody(SuspendBody):
    """How long, and why."""

    force: Force = False


class ConfirmBody(Body):
    """A person's confirmation that services are removed."""

    services: Annotated[list[ServiceName], Field(min_length=1, max_length=300)] = Field(
        description="The services and groups to remove, all of which are withheld."
    )


class DownBody(Body):
    """How a robot is taken down."""

    keep_requests: bool = Field(False, description="Keep the requests for the next run of rorg.")
    volumes: bool = Field(False, description="Also remove its volumes with all data.")
    forget: bool = Field(False, description="Also remove its history: events and revisions.")


class PutManifest(Body):
    """A manifest to write, and the version that it replaces."""

    text: Annotated[str, Field(max_length=500_000)] = Field(description="The manifest, as YAML.")
    base: str | None = Field(default=None, description="Digest of the version that was edited; null for a new one.")
    message: Short = ""
    check: bool = Field(default=False, description="Only check it.")
