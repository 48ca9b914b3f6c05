"""What the API answers about the robot as a whole: status, plan, logs and events, as pydantic models."""

from __future__ import annotations

from pydantic import BaseModel, Field, ValidationError

from rorg.api.models import RequestView, ServiceView


class DiagnosticView(BaseModel):
    """A mistake in a manifest, and its place; line and column count from 1."""

    file: str
    line: int
    column: int
    severity: str = Field(description="error or warning.")
    message: str
    remedy: str
    code: str = Field(
        "", description="The code of a finding (docs/reference/findings.md); empty for a mistake of form."
    )


class GitView(BaseModel):
    """The repository of the manifests."""

    followed: bool = Field(description="Whether rorg fetches it; otherwise the manifests are in a working copy.")
    repository: str = Field(description="Its path or URL, without user and password.")
    branch: str = Field(description="Empty for the repository's default branch.")
    commit: str = Field(description="The commit in force; empty if unknown.")
    fetched_at: str = Field(description="When it was last reached: ISO 8601, UTC; empty before that.")
    error: str = Field(description="Why it cannot be reached, or its last commit is refused; empty when all is well.")


class StandingView(BaseModel):
    """How a state of the manifests has done so far."""

    code: str = Field(description="applying, baking, good or failed.")
    reason: str = Field(description="For people; empty for good.")


class SummaryView(BaseModel):
    """A robot in a few words, for lists of robots."""

    robot: str = Field(description="Whose overlay is used; empty for the base alone.")
    machine: str = Field(description="Which of its computers this is; empty if it has only one.")
    revision: str = Field(description="The git commit of its manifests; empty without one.")
    standing: str = Field(description="applying, baking, untested, good, failed; refused if the manifests have errors.")
    reason: str = Field(description="Why it is not good.")
    health: dict[str, int] = Field(description="How many wanted services have each health.")
    degraded: list[str] = Field(description="Services that are wanted and Degraded; at most 20.")
    drift: int = Field(description="How many services are not as declared.")
    engine: str = Field(description="Why the engine does not answer; empty if it does.")
    down: str = Field(description="going or down; empty if the robot is not taken down.")


class TreeView(BaseModel):
    """The tree of manifests that is in force."""

    root: str = Field(description="Its directory.")
    fingerprint: str = Field(description="Equal fingerprints mean equal declarations.")
    revision: str = Field(description="The git commit; empty without one.")
    robot: str = Field("", description="The robot whose overlay counts; empty for the base alone.")
    git: GitView | None = Field(
        default=None, description="If rorg follows one (`rorg run --git`), or git does not trust it."
    )
    errors: list[DiagnosticView] = Field(
        description="While there are any, the last good tree is in force and nothing is removed."
    )
    warnings: list[DiagnosticView] = Field(default=[], description="Warnings about it; it is in force.")
    standing: StandingView | None = Field(
        default=None, description="How it has done so far; missing until rorg knows what runs."
    )


class EngineView(BaseModel):
    """Whether the engine answers."""

    complete: bool = Field(description="Whether rorg knows what runs; otherwise states are those seen last.")
    error: str = Field(description="Why it is not.")
    address: str = Field("", description="If the engine does not answer.")
    silent_since: str = Field("", description="When it stopped answering pings: ISO 8601, UTC; empty while it answers.")


class ActionView(BaseModel):
    """One engine call that rorg would make."""

    index: int
    verb: str = Field(description="create, update, rename, signal, start, resume, pause, stop or remove.")
    service: str
    container: str = Field(description="Empty for one that an earlier action creates.")
    reason: str
    fields: list[str] = Field(description="Declared options that changed.")
    after: list[int] = Field(description="Actions that must happen before.")
    part_of: str = Field(description="replace or restart, if the action is a part of that; otherwise empty.")
    urgent: bool = Field(description="A live request waits for it.")


class WaitingView(BaseModel):
    """Something that rorg would do, but not now."""

    service: str
    reason: str
    code: str = Field(description="failed, withheld, preempted, suspended or interlock; empty if it only takes time.")


class PlanView(BaseModel):
    """The actions that rorg would take, and the ones that wait."""

    actions: list[ActionView]
    waitings: list[WaitingView]
    summary: str


class BudgetView(BaseModel):
    """What services may use in total; null for everything that the machine has."""

    cpu: float | None = Field(description="Cores.")
    memory: int | None = Field(description="Bytes.")


class PressureView(BaseModel):
    """Measures against overload."""

    reason: str
    measures: list[str] = Field(description="In force, mildest first.")
    helpless: bool = Field(description="Nothing that rorg runs would help.")
    shed: dict[str, str] = Field(description="Services that were shed, each with the reason.")
    budget: BudgetView | None = Field(default=None, description="Of the Policy.")


class RunView(BaseModel):
    """What rorg remembers of a service across its own restarts."""

    run: str = Field(description="The run that relies on the runs in `needs`.")
    needs: dict[str, str] = Field(description="Needed service -> the run of it that it relies on.")
    stopped: str = Field(description="The last run that rorg ended.")
    stopped_before: list[str] | None = Field(default=None, description="Earlier ones, of other kept containers.")
    edition: str | None = Field(default=None, description="The declaration by which its container was put into use.")
    quarantined: dict[str, str] | None = Field(
        default=None, description="Editions that did not become ready or stay well, and why."
    )
    drawn: str | None = Field(default=None, description="Why its change is undone: another member of its set failed.")
    proven: str | None = Field(default=None, description="The container whose trial is over.")
    baked: str | None = Field(default=None, description="The last edition that passed its bake.")
    loaded: str | None = Field(default=None, description="The run that has read `content`.")
    content: dict[str, str] | None = Field(
        default=None, description="Digests of the files that it mounts from the tree."
    )
    attempts: dict[str, tuple[float, str]] | None = Field(
        default=None, description="Verb -> when it is tried again (the machine's monotonic clock, seconds), and why."
    )


class ObjectView(BaseModel):
    """A network or volume."""

    kind: str = Field(description="network or volume.")
    name: str = Field(description="Its name in manifests.")
    engine_name: str = Field(description="Its name in the engine.")
    state: str = Field(description="present, none, foreign (it is not rorg's) or unknown.")
    external: bool = Field(description="Not rorg but someone else makes and removes it.")
    declared: bool = Field(description="A manifest declares it.")
    ours: bool = Field(description="rorg has made it.")
    services: list[str] = Field(description="The services that use it.")
    message: str = Field(description="What it waits for.")


class NotifyView(BaseModel):
    """A target of the Policy's `notify`."""

    name: str
    error: str = Field(description="Why the last notification did not reach it; empty when all is well.")
    sent: int = Field(description="Notifications that reached it since rorg began, or since it was changed.")
    lost: int = Field(description="Those that did not.")


class StatusView(BaseModel):
    """The whole state in one answer."""

    pid: int | None = Field(description="Of the running rorg.")
    engine_name: str
    instance: str = Field(description="The owner of these containers, as in their labels.")
    tree: TreeView
    requests_errors: list[str] = Field(
        description="Mistakes in the requests file; while there are any, its last good content counts."
    )
    engine: EngineView
    suspended: str = Field(description="Why rorg changes nothing now; empty if it is not suspended.")
    down: str = Field(
        default="",
        description="going while the robot is taken down, then down until a person runs it; otherwise empty.",
    )
    withheld: dict[str, str] = Field(description="What stays although no manifest declares it, with the reason.")
    requests: list[RequestView]
    restarts: list[str] = Field(description="Services whose restart is asked for.")
    pressure: PressureView
    plan: PlanView
    runs: dict[str, RunView] = Field(description="By service.")
    objects: list[ObjectView] = Field(default=[], description="Networks and volumes: declared ones, and leftovers.")
    notify: list[NotifyView] = Field(default=[], description="Targets that rorg notifies.")
    in_flight: dict[str, str] = Field(description="Service -> the engine call under way.")
    services: dict[str, ServiceView]


def is_status(value: object) -> bool:
    """Whether a value has the form of what rorg publishes."""
    try:
        StatusView.model_validate(value)
    except ValidationError:
        return False
    return True


class LogView(BaseModel):
    """A line of a service's log; without `text`, the position in its log; with `error`, why it cannot be read."""

    service: str
    cursor: str | None = Field(default=None, description="For `after`, to continue after this line.")
    time: str | None = Field(
        default=None, description="RFC 3339, UTC; with the process engine when rorg saw it, none for earlier lines."
    )
    text: str | None = Field(
        default=None,
        description="With its line end; a long line comes in pieces without. Invalid UTF-8 bytes are U+DC80 and up.",
    )
    error: str | None = None


class EventView(BaseModel):
    """A line of the journal; its fields beyond the first four depend on its kind."""

    seq: int = Field(description="Its number, increasing.")
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
    verb: str | None = Field(default=None, description="Of an action, as in a plan.")
    container: str | None = None
    reason: str | None = None
    fields: list[str] | None = Field(default=None, description="Declared options that changed.")
    error: str | None = Field(default=None, description="Empty if it went well.")
    seconds: float | None = Field(default=None, description="How long it took.")
    file: str | None = None
    crashes: int | None = None
    revision: int | None = Field(default=None, description="Number of a revision of the manifests.")
    node: str | None = Field(default=None, description="Name of a ROS node.")
    bytes: int | None = Field(default=None, description="Memory that was given back.")
    measures: list[str] | None = Field(default=None, description="Measures against overload that are in force.")
    helpless: bool | None = Field(default=None, description="Nothing that rorg runs would help.")
    shed: dict[str, str] | None = Field(default=None, description="Services that were shed, each with the reason.")
    state: str | None = Field(default=None, description="The new state of a service; `none` without a container.")
    states: dict[str, str] | None = Field(default=None, description="States in which rorg found services.")
    failed: bool | None = Field(default=None, description="The service ended on its own with an error.")
