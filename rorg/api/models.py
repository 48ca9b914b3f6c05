"""What the API answers, as pydantic models: they are the OpenAPI document too."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, Field


class RequestView(BaseModel):
    """A request that counts."""

    id: str
    requester: str
    services: list[str]
    reason: str = ""
    priority: int | None = None
    ttl: float | None = Field(default=None, description="Seconds.")
    incarnation: str | None = None
    standing: bool = False
    expires_in: float | None = Field(default=None, description="Seconds that are left of the lease.")
    generation: int | None = Field(default=None, description="Of the change that this answers.")


class ConditionView(BaseModel):
    """One condition of a service, as Kubernetes has them."""

    type: str = Field(
        description="Ready, Requested, Reconciling or Stalled; Updated where a change failed or is tried; Pausable and "
        "NodesUnique only where they are False: pausing it harms others, or another service has a node of its name."
    )
    status: str = Field(description="True, False or Unknown.")
    reason: str
    message: str


class ServiceView(BaseModel):
    """How a service is."""

    service: str
    state: str = Field(
        description="The engine's word, as seen last; none without a container, meta for a meta-service. "
        "unknown before the engine has answered."
    )
    sync: str = Field(description="Synced, OutOfSync or Unknown.")
    health: str = Field(description="Healthy, Progressing, Degraded, Idle, Completed or Unknown.")
    wanted: bool
    why: str
    message: str = Field(description="What keeps it from being as it is wanted; empty where nothing does.")
    container: str
    incarnation: str = Field(description="The run of its container; empty where none is alive.")
    started_at: str
    exits: int
    pid: int
    crashes: int
    effective_priority: int
    held: str
    lowered: bool
    ros_nodes: list[str]
    withheld: str = Field(description="Why it stays though no manifest declares it.")
    driver: bool = Field(description="It moves hardware.")
    labels: dict[str, str] = Field(description="Of its manifest.")
    conditions: list[ConditionView]


class IdleView(BaseModel):
    """What is done with a service that nothing wants."""

    action: str = Field(description="pause, stop or remove.")
    linger: float = Field(description="Seconds until then.")
    connected: str = Field(
        description="pause or stop: what is done instead of a pause while its ROS 1 nodes are connected."
    )


class Description(BaseModel):
    """Everything about a service."""

    name: str
    message: str = Field(description="What keeps it from being as it is wanted; empty where nothing does.")
    description: str
    labels: dict[str, str]
    manifest: str = Field(description="FILE:LINE.")
    needs: list[str]
    conflicts: list[str]
    always_on: bool
    idle: IdleView
    restart: str
    priority: int
    driver: bool
    needed_by: list[str]
    status: ServiceView
    container: dict[str, Any] = Field(description="Its options; of the environment the names alone.")
    sources: dict[str, str] = Field(description="Option, and what of the tree declares it.")
    events: list[str] = Field(description="The last ones of it.")
    log: list[str] = Field(description="The last lines that it printed.")


class GroupView(BaseModel):
    """A name for several services."""

    name: str
    services: list[str]
    description: str


class Edge(BaseModel):
    """That one service needs or requests another."""

    from_: str = Field(alias="from")
    to: str
    kind: Literal["needs", "requests"]


class Graph(BaseModel):
    """Who needs and who requests whom, and who uses what."""

    services: list[str]
    objects: list[str] = Field(default=[], description="Networks and volumes: network/NAME, volume/NAME.")
    always_on: list[str]
    edges: list[Edge]


class ImageEdge(BaseModel):
    """That one image stands on another."""

    from_: str = Field(alias="from")
    to: str


class ImageGraph(BaseModel):
    """What the images of the tree stand on."""

    images: list[str]
    external: list[str] = Field(description="What they stand on and the tree does not declare.")
    edges: list[ImageEdge]
    services: dict[str, list[str]] = Field(description="By image, the services that are made from it, where any are.")


class ImageView(BaseModel):
    """An image of the tree."""

    name: str
    context: str | None = Field(description="Absolute directory of the build; null where nothing is built.")
    dockerfile: str
    bases: list[str] = Field(description="What it stands on: images of the tree, and external ones.")
    services: list[str] = Field(description="Those that are made from it.")


class Held(BaseModel):
    """The services that a change is about."""

    services: list[str]
    generation: int | None = Field(default=None, description="Of this change.")


class Ready(BaseModel):
    """Whether one service is ready."""

    ready: bool
    incarnation: str = Field(description="The run that this is said of; empty where nothing runs.")
    reason: str = Field(description="Why it is not ready.")


class WaitResult(BaseModel):
    """How a wait ended."""

    ready: bool
    services: dict[str, Ready] = Field(description="Those asked for, and all that they need.")


class Link(BaseModel):
    """A service, and why it is wanted."""

    service: str
    kind: str = Field(description="always_on, meta, requested or needed.")
    by: str = Field(description="The service that requests or needs it.")
    request: str = Field(description="The id of the request.")
    text: str = Field(description="The same, for people.")


class Why(BaseModel):
    """Why a service is active, or why not."""

    service: str
    wanted: bool
    state: str
    chain: list[Link] = Field(description="From the service to a root; empty when it is not wanted.")
    requests: list[RequestView] = Field(description="Those that name it, or a group of it.")
    needed_by: list[str] = Field(description="Services that declare that they need it.")
    waits: list[str] = Field(description="Why what would be done with it is not done now.")
    cautions: list[str] = Field(description="What pausing it does to others, and which ROS nodes another one has.")


class ProcessView(BaseModel):
    """The process at a port of this machine."""

    port: int
    pid: int
    service: str
    """The service that runs it; empty where none does."""


class ServiceUsage(BaseModel):
    """CPU seconds since its container began, and bytes of memory now."""

    cpu_seconds: float
    memory: int


class MachineUsage(BaseModel):
    """Of the whole machine; memory in bytes, `*_some` percent of time (PSI, avg10)."""

    cpu_seconds: float = Field(description="Of all processes since it booted.")
    cores: int
    memory: int = Field(description="In use.")
    memory_total: int
    cpu_some: float
    memory_some: float


class Usage(BaseModel):
    """What runs uses, and the machine."""

    at: float = Field(description="Seconds since the epoch.")
    services: dict[str, ServiceUsage]
    machine: MachineUsage


class ManifestView(BaseModel):
    """A manifest of the tree."""

    kind: str
    name: str
    file: str = Field(description="Relative to the tree.")
    digest: str
    generation: int | None = Field(default=None, description="Of the change that this answers.")


class Differences(BaseModel):
    """What is to be done, and why."""

    root: str = Field(description="The tree that rorg follows.")
    robot: str = Field(description="Whose overlay is laid over it; empty for the base alone.")
    commit: str = Field(description="Whose manifests these are, where `rev` was asked for; else empty.")
    fingerprint: str = Field(description="Of the manifests that this was made from.")
    errors: list[dict[str, Any]] = Field(description="Of the tree; while there are any, the last good one counts.")
    warnings: list[dict[str, Any]] = Field(default=[], description="Of the tree: what is wrong, though it counts.")
    requests_errors: list[str]
    withheld: list[str] = Field(description="Whose removal waits for a person's word.")
    probed: list[str] = Field(description="Services that have a probe of their readiness.")
    empty: bool = Field(description="There is nothing to do, and nothing waits.")
    text: str = Field(description="The plan step by step, for people.")
    services: list[dict[str, Any]] = Field(
        description="The same service by service: `verbs`, `why`, `changes` (field, old, new, with what may be secret "
        "masked), and all of that as a `line`."
    )
    unified: dict[str, str] = Field(
        description="Where it was asked for: by service, each container that changes as a unified diff, masked too."
    )
    suspended: str = Field(description="Why nothing of it is done now; empty where rorg is not suspended.")
    plan: dict[str, Any]


class Problem(BaseModel):
    """RFC 9457, with a stable code."""

    type: str
    title: str
    status: int
    code: str
    cause: str
    remedy: str
    services: dict[str, Ready] | None = Field(default=None, description="Of not-ready: how each service is.")
    confirm: list[str] | None = Field(
        default=None, description="Of refused: the services that it would touch, where `force` does it."
    )
