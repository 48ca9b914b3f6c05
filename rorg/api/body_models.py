"""What callers of the API send, as pydantic models: they are the OpenAPI document too."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Short = Annotated[str, Field(max_length=500)]
ServiceName = Annotated[str, Field(min_length=1, max_length=64)]


class Body(BaseModel):
    """What callers send; unknown fields are refused."""

    model_config = ConfigDict(extra="forbid")


class PutRequest(Body):
    """What is requested."""

    services: Annotated[list[ServiceName], Field(min_length=1, max_length=300)]
    reason: Short = ""
    priority: Annotated[int, Field(ge=0, le=100)] | None = None
    ttl: Annotated[str, Field(max_length=20)] | None = Field(default=None, description="Lease, such as 10s.")


Force = Annotated[bool, Field(description="Though it stops what moves hardware, or others with it.")]


class SuspendBody(Body):
    """For how long, and why."""

    duration: Annotated[str, Field(max_length=20)] = Field(description="How long, such as 10m.")
    reason: Short = ""


class HoldBody(SuspendBody):
    """For how long, and why."""

    force: Force = False


class HoldsBody(Body):
    """Several services at once: for how long, and why."""

    services: Annotated[list[ServiceName], Field(min_length=1, max_length=300)]
    duration: Annotated[str, Field(max_length=20)] | None = Field(
        default=None, description="How long, such as 10m; null ends their holds."
    )
    reason: Short = ""
    force: Force = False


class RetryBody(Body):
    """What to try again."""

    services: Annotated[list[ServiceName], Field(min_length=1, max_length=300)] = Field(
        description="Services and groups of which a change failed."
    )
    force: Force = False


class ConfirmBody(Body):
    """A person's word that services go."""

    services: Annotated[list[ServiceName], Field(min_length=1, max_length=300)] = Field(
        description="Exactly what is to go: services and groups whose removal is withheld."
    )


class DownBody(Body):
    """How a robot is taken down."""

    keep_requests: bool = Field(False, description="Keep what was requested for the next time that rorg runs.")
    volumes: bool = Field(False, description="Remove its volumes too, with all that is in them.")


class PutManifest(Body):
    """A manifest to write, and the version that it takes the place of."""

    text: Annotated[str, Field(max_length=500_000)] = Field(description="The manifest, as YAML.")
    base: str | None = Field(default=None, description="Digest of the version that was edited; null for a new one.")
    message: Short = ""
