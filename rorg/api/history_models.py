"""What the API gives of the history, as pydantic models."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, Field

from rorg.api.status_models import EventView


class RevisionView(BaseModel):
    """A state of the manifests that was applied or refused."""

    number: int = Field(description="1, 2, ...")
    at: str = Field(description="ISO 8601, UTC: when it was taken into use.")
    fingerprint: str = Field(description="Of the manifests' content.")
    commit: str = Field(description="Of git; empty outside of a repository.")
    author: str = Field(description="Of the commit.")
    subject: str = Field(description="Of the commit.")
    dirty: bool = Field(description="Files differed from the commit.")
    robot: str = Field(description="Whose overlay was laid over the manifests.")
    standing: str = Field(description="applying, baking, good, failed, superseded or refused.")
    reason: str = Field(description="Why it has that standing.")
    settled_at: str = Field(description="ISO 8601, UTC: since when.")
    errors: list[str] = Field(description="Of a refused one.")


class MadeView(BaseModel):
    """What a container of a service is made from."""

    digest: str = Field(description="Of the rendered options.")
    declared: str = Field(description="The rendered options, as JSON; what may be secret is masked.")
    image: str = Field(description="Its reference.")
    image_id: str = Field(description="The engine's id of it; empty where it was never known.")
    edition: str = Field(description="Of the manifest, and of what it mounts.")


class RevisionDetail(RevisionView):
    """All of it."""

    plan: str = Field(description="What was to be done on its word, as text.")
    services: dict[str, MadeView]


class FieldChange(BaseModel):
    """A declared option that is another; null where there is none. What may be secret is masked."""

    field: str
    old: Any
    new: Any
    text: str = Field(description="Both in one line.")


class ServiceChange(BaseModel):
    """A service that one revision has otherwise than another."""

    service: str
    change: str = Field(description="added, removed or changed.")
    fields: list[FieldChange]


class Comparison(BaseModel):
    """What differs between two revisions."""

    old: RevisionView
    new: RevisionView
    services: list[ServiceChange]


class SpanView(BaseModel):
    """A time in one state."""

    state: str = Field(description="The engine's word; none without a container, ready for one that runs and is ready.")
    begin: str = Field(description="ISO 8601, UTC.")
    end: str | None = Field(description="Null where it goes on.")
    seconds: float
    why: str
    who: str = Field(description="Who had asked for it, as far as that is on record.")


class Timeline(BaseModel):
    """What a service went through."""

    service: str
    begin: str = Field(description="ISO 8601, UTC.")
    end: str
    spans: list[SpanView]


class MeasuredView(BaseModel):
    """What a service used while it ran; paused time is left out."""

    service: str
    runs: int
    seconds: float = Field(description="For which it ran and was measured.")
    cpu: float = Field(description="Cores, in the mean.")
    memory: int = Field(description="Bytes, in the mean.")
    peak_memory: int = Field(description="The most bytes that were seen; once a minute, and before it ceased.")


class Asking(BaseModel):
    """A request that is made, or made anew; or released, where it names no services."""

    at: str = Field(description="ISO 8601, UTC.")
    requester: str
    id: str
    services: list[str] = Field(description="Services and groups.")


class Requested(BaseModel):
    """What a robot was asked for."""

    begin: str = Field(description="ISO 8601, UTC: no earlier than what is on record.")
    end: str
    unknown: int = Field(description="Requests on record without what they name; an earlier rorg wrote them.")
    requests: list[Asking] = Field(description="In order of time.")


class RecordView(BaseModel):
    """A line of the export: a revision or an event. `schemas/journal.proto` says the same."""

    revision: RevisionDetail | None = None
    event: EventView | None = None
