"""What the API gives that is about the robot as a whole: status, plan and events, as pydantic models."""

from __future__ import annotations

from pydantic import BaseModel, Field, ValidationError

from rorg.api.models import RequestView, ServiceView


class DiagnosticView(BaseModel):
    """What is wrong with a manifest, and where; line and column count from 1."""

    file: str
    line: int
    column: int
    severity: str = Field(description="error or warning.")
    message: str
    remedy: str
    code: str = Field("", description="What is found, one of docs/reference/findings.md; empty for a mistake of form.")


class GitView(BaseModel):
    """The repository that the manifests come from."""

    followed: bool = Field(description="Whether it is fetched from there; otherwise they lie in it.")
    repository: str = Field(description="Without the user and the password of a URL.")
    branch: str = Field(description="Empty for the one that it is at itself.")
    commit: str = Field(description="In force; empty where that is not known.")
    fetched_at: str = Field(description="When it was last reached: ISO 8601, UTC; empty before that.")
    error: str = Field(description="Why it cannot be reached, or its last commit is refused; empty when all is well.")


class StandingView(BaseModel):
    """How a state of the manifests has done so far."""

    code: str = Field(description="applying, baking, good or failed.")
    reason: str = Field(description="For people; empty for good.")


class TreeView(BaseModel):
    """The tree of manifests that is in force."""

    root: str = Field(description="Its directory.")
    fingerprint: str = Field(description="Two equal ones declare the same.")
    revision: str = Field(description="The git commit; empty without one.")
    robot: str = Field("", description="Whose overlay is laid over it; empty for the base alone.")
    git: GitView | None = Field(
        default=None, description="Where one is followed (`rorg run --git`), or git does not trust it."
    )
    errors: list[DiagnosticView] = Field(
        description="While there are any, the last good tree is in force and nothing is removed on its word."
    )
    warnings: list[DiagnosticView] = Field(default=[], description="What is wrong with it, though it is in force.")
    standing: StandingView | None = Field(
        default=None, description="How it has done so far; missing until rorg knows what runs."
    )


class EngineView(BaseModel):
    """Whether the engine answers."""

    complete: bool = Field(description="Whether it is known what runs; otherwise states are those that were seen last.")
    error: str = Field(description="Why it is not.")
    address: str = Field("", description="Of an engine that does not answer.")
    silent_since: str = Field("", description="When it stopped answering pings: ISO 8601, UTC; empty while it answers.")


class ActionView(BaseModel):
    """One engine call that is to be made."""

    index: int
    verb: str = Field(description="create, update, rename, signal, start, resume, pause, stop or remove.")
    service: str
    container: str = Field(description="Empty for one that an earlier action creates.")
    reason: str
    fields: list[str] = Field(description="Declared options that changed.")
    after: list[int] = Field(description="Actions that must have happened before.")
    part_of: str = Field(description="replace or restart for actions that do that together; else empty.")
    urgent: bool = Field(description="A live request waits for it.")


class WaitingView(BaseModel):
    """Something that would be done, but not now."""

    service: str
    reason: str
    code: str = Field(description="failed, withheld, preempted or suspended; empty for what only takes its time.")


class PlanView(BaseModel):
    """What is to be done, and what waits."""

    actions: list[ActionView]
    waitings: list[WaitingView]
    summary: str


class BudgetView(BaseModel):
    """What services may use in all; null for all that the machine has."""

    cpu: float | None = Field(description="Cores.")
    memory: int | None = Field(description="Bytes.")


class PressureView(BaseModel):
    """What is done against overload."""

    reason: str
    measures: list[str] = Field(description="In force, mildest first.")
    helpless: bool = Field(description="Nothing that rorg runs would help.")
    shed: dict[str, str] = Field(description="Services that had to make room, each with the reason.")
    budget: BudgetView | None = Field(default=None, description="Of the Policy.")


class RunView(BaseModel):
    """What rorg keeps in mind of a service beyond its own runs."""

    run: str = Field(description="The run that counts on runs of what it needs.")
    needs: dict[str, str] = Field(description="Service that it needs, and the run of it that it counts on.")
    stopped: str = Field(description="The last run that rorg ended itself.")
    stopped_before: list[str] | None = Field(
        default=None, description="Earlier ones, of other containers that are kept."
    )
    edition: str | None = Field(default=None, description="What was declared when its container was taken into use.")
    quarantined: dict[str, str] | None = Field(
        default=None, description="Editions that did not come up, or did not stay well, and why."
    )
    drawn: str | None = Field(default=None, description="Why its change is undone: one of its set failed.")
    proven: str | None = Field(default=None, description="The container whose trial is over.")
    baked: str | None = Field(default=None, description="The edition that has stayed well for its bake.")
    loaded: str | None = Field(default=None, description="The run that has read `content`.")
    content: dict[str, str] | None = Field(default=None, description="Digests of what it mounts from the tree.")
    attempts: dict[str, tuple[float, str]] | None = Field(
        default=None, description="Verb, and when it is tried again (the machine's monotonic clock, seconds), and why."
    )


class ObjectView(BaseModel):
    """A network or volume."""

    kind: str = Field(description="network or volume.")
    name: str = Field(description="What services write.")
    engine_name: str = Field(description="What the engine calls it.")
    state: str = Field(description="present, none, foreign (it is not rorg's) or unknown.")
    external: bool = Field(description="Somebody else makes and removes it.")
    declared: bool = Field(description="A manifest declares it.")
    ours: bool = Field(description="rorg has made it.")
    services: list[str] = Field(description="That use it.")
    message: str = Field(description="What it waits for.")


class StatusView(BaseModel):
    """Everything at once."""

    pid: int | None = Field(description="Of the running rorg.")
    engine_name: str
    instance: str = Field(description="The owner whose containers these are.")
    tree: TreeView
    requests_errors: list[str] = Field(
        description="Of the requests file; while there are any, its last content counts."
    )
    engine: EngineView
    suspended: str = Field(description="Why nothing is changed now; empty when it is.")
    down: str = Field(
        default="",
        description="going while the robot is taken down, down from then on until somebody runs it; otherwise empty.",
    )
    withheld: dict[str, str] = Field(description="What stays though no manifest declares it, with the reason.")
    requests: list[RequestView]
    restarts: list[str] = Field(description="Services whose restart is asked for.")
    pressure: PressureView
    plan: PlanView
    runs: dict[str, RunView] = Field(description="By service.")
    objects: list[ObjectView] = Field(default=[], description="Networks and volumes: declared ones, and what is left.")
    in_flight: dict[str, str] = Field(description="Service, and the engine call that is under way.")
    services: dict[str, ServiceView]


def is_status(value: object) -> bool:
    """Whether what was read is what an rorg publishes."""
    try:
        StatusView.model_validate(value)
    except ValidationError:
        return False
    return True


class LogView(BaseModel):
    """A line of a service's log; without `text`, where its log stands; with `error`, why it cannot be read."""

    service: str
    cursor: str | None = Field(default=None, description="As `after`: go on behind this line.")
    time: str | None = Field(
        default=None, description="RFC 3339, UTC; of the process engine when it was seen, and none for lines of before."
    )
    text: str | None = Field(
        default=None,
        description="With its line end; a long line comes in pieces without. Bytes that are no UTF-8 are U+DC80 on.",
    )
    error: str | None = None


class EventView(BaseModel):
    """A line of the journal; which fields it has beyond the first four depends on its kind."""

    seq: int = Field(description="Its number; they grow.")
    at: str = Field(description="ISO 8601, UTC.")
    kind: str = Field(description="A stable word.")
    message: str
    author: str | None = Field(default=None, description="Who asked for it.")
    service: str | None = None
    services: list[str] | None = None
    requests: list[str] | None = Field(default=None, description="Requests (REQUESTER/ID, or ids) that it concerns.")
    request: str | None = None
    requested: list[str] | None = Field(default=None, description="Services and groups that a request names.")
    cause: str | None = Field(default=None, description="Of `lost` and `pause-risk`: a stable word.")
    incarnation: str | None = Field(default=None, description="The run that it is about.")
    verb: str | None = None
    container: str | None = None
    reason: str | None = None
    fields: list[str] | None = None
    error: str | None = None
    seconds: float | None = Field(default=None, description="How long it took.")
    file: str | None = None
    crashes: int | None = None
    node: str | None = Field(default=None, description="Of a ROS node.")
    bytes: int | None = Field(default=None, description="Of memory that was given back.")
    measures: list[str] | None = None
    helpless: bool | None = None
    shed: dict[str, str] | None = None
    state: str | None = Field(default=None, description="That a service has come into; `none` without a container.")
    states: dict[str, str] | None = Field(default=None, description="That services were found in.")
