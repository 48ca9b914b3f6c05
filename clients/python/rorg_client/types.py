"""The answers of rorg as types, after the schemas of its API (schemas/openapi.json)."""

from __future__ import annotations

from typing import Any, Dict, TypedDict

from rorg_client.loss import Loss as Loss


class Readiness(TypedDict):
    """The readiness of a service. `incarnation` is the run that is ready."""

    ready: bool
    incarnation: str
    reason: str


class Condition(TypedDict):
    """`type` is Ready, Requested, Reconciling, Stalled, or one of the API's others; `status` True, False or Unknown."""

    type: str
    status: str
    reason: str
    message: str


class ServiceView(TypedDict):
    """The state of a service. `health` is Healthy, Progressing, Degraded, Completed, Preempted, Waiting, Idle or
    Unknown; `rivals` have what it waits for."""

    service: str
    state: str
    sync: str
    health: str
    wanted: bool
    why: str
    rivals: list[str]
    message: str
    container: str
    incarnation: str
    started_at: str
    exits: int
    pid: int
    crashes: int
    effective_priority: int
    held: str
    machine: str
    lowered: bool
    ros_nodes: list[str]
    withheld: str
    driver: bool
    labels: dict[str, str]
    conditions: list[Condition]


class RequestView(TypedDict):
    """A request that counts. `ttl` and `expires_in` are seconds; only a call that waited gets `readiness`."""

    id: str
    requester: str
    services: list[str]
    reason: str
    priority: int | None
    ttl: float | None
    incarnation: str | None
    standing: bool
    expires_in: float | None
    readiness: dict[str, Readiness]


class Link(TypedDict):
    """A service, and why it is wanted: `kind` is always_on, meta, requested (`by` a service, with a `request`'s id) or
    needed (`by` a service); `text` is the same for people."""

    service: str
    kind: str
    by: str
    request: str
    text: str


class Rival(TypedDict):
    """An active service that has what another one waits for, and who wants it."""

    service: str
    text: str


class Why(TypedDict):
    """Why a service is active, or why not. `chain` leads from it to a root, also if it is kept out; then `rivals` have
    what it waits for, and `remedies` are commands that let it in. `needed_by` are services."""

    service: str
    wanted: bool
    health: str
    state: str
    chain: list[Link]
    requests: list[RequestView]
    needed_by: list[str]
    rivals: list[Rival]
    remedies: list[str]
    waits: list[str]
    cautions: list[str]


class ServiceUsage(TypedDict):
    cpu_seconds: float
    memory: int


class Usage(TypedDict):
    """CPU seconds and bytes of each service that runs. `at` is seconds since the epoch."""

    at: float
    services: dict[str, ServiceUsage]
    machine: dict[str, float]


class ManifestView(TypedDict):
    """A manifest of the tree; `digest` is that of its text."""

    kind: str
    name: str
    file: str
    digest: str


class GroupView(TypedDict):
    name: str
    services: list[str]
    description: str


class _EventBase(TypedDict):
    seq: int
    at: str
    kind: str
    message: str


class Event(_EventBase, total=False):
    """A line of the journal. `kind` is a stable word."""

    author: str
    service: str
    services: list[str]
    requests: list[str]
    request: str
    cause: str
    incarnation: str
    verb: str
    container: str
    reason: str
    fields: list[str]
    error: str
    seconds: float
    file: str
    crashes: int


Spec = Dict[str, Any]
"""The `spec` of a manifest."""
