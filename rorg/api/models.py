"""What the API answers, as pydantic models, which are in the OpenAPI document too. Answers are not validated by them
when they are sent, for speed; tests/process/test_api_schema.py checks that they match."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, Field

from rorg.model.health import Health


class Ready(BaseModel):
    """Whether one service is ready."""

    ready: bool
    incarnation: str = Field(description="The run that is meant; empty if nothing runs.")
    reason: str = Field(description="Why it is not ready.")


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
    expires_in: float | None = Field(default=None, description="Seconds left of the lease.")
    generation: int | None = Field(default=None, description="Of the change.")
    readiness: dict[str, Ready] | None = Field(default=None, description="Of a call that waited for it.")


class ConditionView(BaseModel):
    """One condition of a service, as in Kubernetes."""

    type: str = Field(
        description="Ready, Requested, Reconciling or Stalled; Updated if a change failed or is on trial; Pausable and "
        "NodesUnique only if they are False: pausing it harms others, or another service has a node of the same name."
    )
    status: str = Field(description="True, False or Unknown.")
    reason: str
    message: str


class ServiceView(BaseModel):
    """The state of a service."""

    service: str
    state: str = Field(
        description="The engine's word, as seen last; stopping while a stop is under way, none without a container, "
        "meta for a meta-service, unknown before the engine has answered."
    )
    sync: str = Field(description="Synced, OutOfSync or Unknown: whether its container is as its manifest declares it.")
    health: str = Field(description=f"One of {', '.join(Health)}.")
    wanted: bool = Field(description="It must be active now.")
    why: str = Field(description="Who wants it, even if it is kept out; otherwise what keeps it idle.")
    rivals: list[str] = Field(default=[], description="Active services that have what it waits for.")
    message: str = Field(description="What keeps it from its desired state; empty if nothing does.")
    container: str
    incarnation: str = Field(description="The run of its container; empty if none is alive.")
    started_at: str
    exits: int
    pid: int
    crashes: int
    effective_priority: int
    held: str
    machine: str = Field("", description="The computer that it belongs to, if the robot has several.")
    lowered: bool
    ros_nodes: list[str]
    withheld: str = Field(description="Why it stays although no manifest declares it.")
    driver: bool = Field(description="It moves hardware.")
    labels: dict[str, str] = Field(description="Of its manifest.")
    conditions: list[ConditionView]


class IdleView(BaseModel):
    """What happens to a service that nothing wants."""

    action: str = Field(description="pause, stop or remove.")
    linger: float = Field(description="Seconds until then.")
    connected: str = Field(
        description="pause or stop: the action instead of a pause while its ROS 1 nodes are connected."
    )


class Description(BaseModel):
    """Everything about a service."""

    name: str
    message: str = Field(description="What keeps it from its desired state; empty if nothing does.")
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
    container: dict[str, Any] = Field(description="Its options; of the environment only the names.")
    sources: dict[str, str] = Field(description="Field -> what declares it, as `rorg explain SERVICE` says.")
    events: list[str] = Field(description="Its last events.")
    log: list[str] = Field(description="The last lines that it printed.")


class GroupView(BaseModel):
    """A name for several services."""

    name: str
    services: list[str]
    description: str


class Edge(BaseModel):
    """One service needs or requests another."""

    from_: str = Field(alias="from")
    to: str
    kind: Literal["needs", "requests"]


class Graph(BaseModel):
    """Who needs and who requests whom, and who uses which network or volume."""

    services: list[str]
    objects: list[str] = Field(default=[], description="Networks and volumes: network/NAME, volume/NAME.")
    always_on: list[str]
    edges: list[Edge]


class ImageEdge(BaseModel):
    """One image is built on another."""

    from_: str = Field(alias="from")
    to: str


class ImageGraph(BaseModel):
    """The base images of the tree's images."""

    images: list[str]
    external: list[str] = Field(description="Images below them that the tree does not declare.")
    edges: list[ImageEdge]
    services: dict[str, list[str]] = Field(description="Image -> the services that are made from it, if any.")


class ImageView(BaseModel):
    """An image of the tree."""

    name: str
    context: str | None = Field(description="Absolute directory of the build; null if nothing is built.")
    dockerfile: str
    bases: list[str] = Field(description="Its base images: images of the tree, and external ones.")
    services: list[str] = Field(description="Those that are made from it.")


class Held(BaseModel):
    """The services that a change is about."""

    services: list[str]
    generation: int | None = Field(default=None, description="Of this change.")


class WaitResult(BaseModel):
    """The result of a wait."""

    ready: bool
    services: dict[str, Ready] = Field(description="Those asked for, and all that they need.")


class Link(BaseModel):
    """A service, and why it is wanted."""

    service: str
    kind: str = Field(description="always_on, meta, requested or needed.")
    by: str = Field(description="The service that requests or needs it.")
    request: str = Field(description="The id of the request.")
    text: str = Field(description="The same, for people.")


class Rival(BaseModel):
    """An active service that has what another one waits for."""

    service: str
    text: str = Field(description="Who wants it, from the service to a root.")


class Why(BaseModel):
    """Why a service is active, or why not."""

    service: str
    wanted: bool
    state: str
    health: str = Field(description=f"One of {', '.join(Health)}.")
    chain: list[Link] = Field(
        description="Who wants it, from the service to a root, even if it is kept out; empty if nothing does."
    )
    requests: list[RequestView] = Field(description="Those that name it, or a group of it.")
    needed_by: list[str] = Field(description="Services whose manifests need it.")
    rivals: list[Rival] = Field(description="Active services that have what it waits for.")
    remedies: list[str] = Field(description="Commands after which a service that is kept out may be active.")
    waits: list[str] = Field(description="Why rorg does not act on it now.")
    cautions: list[str] = Field(
        description="Effects of pausing it on others, ROS nodes that others have too, a bad change."
    )


class ProcessView(BaseModel):
    """The process at a port of this machine."""

    port: int
    pid: int
    service: str
    """The service that runs it; empty if none does."""


class ServiceUsage(BaseModel):
    """CPU seconds since the container began, and current bytes of memory."""

    cpu_seconds: float
    memory: int


class MachineUsage(BaseModel):
    """Of the whole machine; memory in bytes, `*_some` percent of time (PSI, avg10)."""

    cpu_seconds: float = Field(description="Of all processes since the machine booted.")
    cores: int
    memory: int = Field(description="In use.")
    memory_total: int
    cpu_some: float
    memory_some: float


class Usage(BaseModel):
    """What running services use, and the machine."""

    at: float = Field(description="Seconds since the epoch.")
    services: dict[str, ServiceUsage]
    machine: MachineUsage


class ManifestView(BaseModel):
    """A manifest of the tree."""

    kind: str
    name: str
    file: str = Field(description="Relative to the tree.")
    digest: str
    generation: int | None = Field(default=None, description="Of the change.")


class Differences(BaseModel):
    """The actions that rorg would take, and why."""

    root: str = Field(description="The tree that rorg follows.")
    robot: str = Field(description="The robot whose overlay counts; empty for the base alone.")
    commit: str = Field(description="The commit of the manifests, with `rev`; otherwise empty.")
    fingerprint: str = Field(description="Of these manifests.")
    errors: list[dict[str, Any]] = Field(
        description="Mistakes in the tree; while there are any, the last good tree counts."
    )
    warnings: list[dict[str, Any]] = Field(
        default=[], description="Warnings about the tree, which counts nevertheless."
    )
    requests_errors: list[str]
    withheld: list[str] = Field(description="What waits for confirmation of its removal.")
    probed: list[str] = Field(description="Services with a readiness probe.")
    empty: bool = Field(description="Whether there is nothing to do, and nothing waits.")
    text: str = Field(description="The plan step by step, for people.")
    services: list[dict[str, Any]] = Field(
        description="The same service by service: `verbs` (`probe`: only its probes change), `why`, `changes` (field, "
        "old, new; possible secrets masked), and all of that as a `line`."
    )
    unified: dict[str, str] = Field(description="With `unified`: service -> unified diff of its container, masked too.")
    suspended: str = Field(description="Why nothing of it is done now; empty if rorg is not suspended.")
    plan: dict[str, Any]


class Problem(BaseModel):
    """An error as in RFC 9457, with a stable code."""

    type: str
    title: str
    status: int
    code: str
    cause: str
    remedy: str
    services: dict[str, Ready] | None = Field(default=None, description="If not ready: the state of each service.")
    confirm: list[str] | None = Field(
        default=None, description="If refused: the services that it would affect with `force`."
    )
