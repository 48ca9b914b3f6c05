"""What the API answers about the history, as pydantic models."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, Field

from rorg.api.status_models import EventView


class RevisionView(BaseModel):
    """A state of the manifests that was applied or refused."""

    number: int = Field(description="1, 2, ...")
    at: str = Field(description="ISO 8601, UTC: when it was taken into use.")
    fingerprint: str = Field(description="Of the manifests' content.")
    commit: str = Field(description="The git commit; empty outside of a repository.")
    author: str = Field(description="Of the commit.")
    subject: str = Field(description="Of the commit.")
    dirty: bool = Field(description="Files differed from the commit.")
    robot: str = Field(description="The robot whose overlay counted.")
    standing: str = Field(description="applying, baking, untested, good, failed, superseded or refused.")
    reason: str = Field(description="Why it has that standing.")
    settled_at: str = Field(description="ISO 8601, UTC: when it got that standing.")
    proven_at: str = Field(description="ISO 8601, UTC: when it became good for the first time.")
    errors: list[str] = Field(description="If it was refused.")


class MadeView(BaseModel):
    """The image, files and options that a service's container is made from."""

    digest: str = Field(description="Of the rendered options.")
    declared: str = Field(description="The rendered options, as JSON; possible secrets are masked.")
    image: str = Field(description="Its reference.")
    image_id: str = Field(description="Its id in the engine; empty if unknown.")
    edition: str = Field(description="Digest of the manifest and of the files that it mounts.")


class RevisionDetail(RevisionView):
    """Everything about a revision, which is a state of the manifests that was applied or refused."""

    plan: str = Field(description="The actions that rorg took for it, as text.")
    services: dict[str, MadeView]


class EarlierView(BaseModel):
    """A revision that a rollback may return to."""

    number: int
    doubt: str = Field(
        description="Why it cannot be trusted; empty if each service that changes was proven then, and everything "
        "changes that fails now and was well once."
    )
    unchanged: list[str] = Field(description="Services that fail now, and that it would not change.")


class FieldChange(BaseModel):
    """A declared option that changed; null if it was or is not set. Possible secrets are masked."""

    field: str
    old: Any
    new: Any
    text: str = Field(description="Both in one line.")


class ServiceChange(BaseModel):
    """A service that differs between two revisions."""

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
    end: str | None = Field(description="Null if it goes on.")
    seconds: float
    why: str
    who: str = Field(description="Who had asked for it, if that is on record.")
    failed: bool = Field(False, description="Whether it came into this state unexpectedly.")


class Timeline(BaseModel):
    """The states of a service over time."""

    service: str
    begin: str = Field(description="ISO 8601, UTC.")
    end: str
    spans: list[SpanView]


class MeasuredView(BaseModel):
    """What a service used while it ran; paused time is left out."""

    service: str
    runs: int
    seconds: float = Field(description="How long it ran and was measured.")
    cpu: float = Field(description="Mean, in cores.")
    memory: int = Field(description="Mean, in bytes.")
    peak_memory: int = Field(description="Highest sample, in bytes; once a minute, and before it ceased.")


class SlotView(BaseModel):
    """What was used in some seconds from a time on."""

    at: str = Field(description="ISO 8601, UTC, up to the minute, the ten minutes or the hour that it stands for.")
    seconds: float = Field(description="60, 600 or 3600: minutes are added up after two hours.")
    service: str = Field(description="Empty: the whole machine.")
    cores: float = Field(description="Mean, also over the time in which the service did not run.")
    memory: float = Field(description="The same, in bytes.")


class Asking(BaseModel):
    """A request; or a release, if it names no services."""

    at: str = Field(description="ISO 8601, UTC.")
    requester: str
    id: str
    services: list[str] = Field(description="Services and groups.")
    reason: str = ""


class Requested(BaseModel):
    """The requests that a robot received."""

    begin: str = Field(description="ISO 8601, UTC: not before the first record.")
    end: str
    unknown: int = Field(description="Requests on record without their services: an earlier rorg wrote them.")
    requests: list[Asking] = Field(description="In order of time.")


class RecordView(BaseModel):
    """A line of the export: a revision or an event. `schemas/journal.proto` defines the same."""

    revision: RevisionDetail | None = None
    event: EventView | None = None
