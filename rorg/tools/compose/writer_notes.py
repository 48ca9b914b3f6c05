"""Notes on everything in manifests that a Compose file cannot say: one row for each field, so that none is
forgotten."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from rorg.model.catalog import DEVELOPER, Catalog, Idle, Service, Updating
from rorg.model.graph import parents_first, stands_on
from rorg.model.image_names import declared, stem
from rorg.model.probe import Probe
from rorg.model.units import format_duration, format_memory
from rorg.tools.compose.writer_images import is_directory
from rorg.tools.compose.writer_profiles import profiles
from rorg.tools.compose.writer_text import Note

Say = Callable[[Service], str]


def _resources(service: Service) -> str:
    cpu = [f"cpu {service.cpu:g}"] if service.cpu else []
    memory = [f"memory {format_memory(service.memory)}"] if service.memory else []
    return ", ".join(cpu + memory)


def _idle(service: Service) -> str:
    idle = service.idle
    if idle == Idle():
        return ""
    return f"{idle.action} after {format_duration(idle.linger)}; Compose never stops a service that is not in use"


def condition(ready: Probe | None) -> str:
    """The condition of `depends_on` for a service with this readiness."""
    if ready is not None and any(probe.kind == "engine" for probe in ready.questions):
        return "service_healthy"
    if ready is not None and ready.completed:
        return "service_completed_successfully"
    return "service_started"


def _ready(service: Service) -> str:
    if service.ready is None:
        return ""
    if condition(service.ready) != "service_started":
        others = [str(probe) for probe in service.ready.questions if probe.kind not in ("engine", "completed")]
        return f"{' and '.join(others)}; Compose waits only for the healthcheck" if others else ""
    return f"{service.ready}; Compose waits only for its start. A healthcheck would do more"


def _update(service: Service) -> str:
    return "" if service.update == Updating() else "Compose replaces a changed service immediately, and never goes back"


def _names(names: tuple[str, ...]) -> str:
    return ", ".join(names)


def _ros_parameters(service: Service) -> str:
    """Parameters of a ROS 1 master. Those of ROS 2 are a file."""
    lost = service.ros.values if service.ros and service.domain is None else {}
    return f"{_names(tuple(lost))}; Compose sets no parameters" if lost else ""


SERVICE: tuple[tuple[str, Say], ...] = (
    ("always_on", lambda s: "Compose starts every service that `up` names" if s.always_on else ""),
    ("conflicts", lambda s: _names(s.conflicts)),
    ("exclusive", lambda s: ", ".join(f"{k}: {v}" for k, v in sorted(s.exclusive.items()))),
    ("may_request", lambda s: _names(s.may_request)),
    ("may_restart", lambda s: _names(s.may_restart)),
    ("may_act_for", lambda s: _names(s.may_act_for)),
    ("machine", lambda s: f"it runs on {s.machine}: Compose has one machine" if s.machine else ""),
    ("may_report_graph", lambda s: "Compose has no rorg" if s.may_report_graph else ""),
    ("may_manage", lambda s: _names(s.may_manage)),
    ("idle", _idle),
    ("update", _update),
    ("ready", _ready),
    ("live", lambda s: f"{s.live}; Compose does not restart a service that hangs" if s.live else ""),
    (
        "interlock",
        lambda s: f"{s.interlock}; Compose has no check before it touches a container" if s.interlock else "",
    ),
    ("protected", lambda s: "Compose stops any service" if s.protected else ""),
    ("devices", lambda s: "Compose does not wait for devices, or stop services without them" if s.devices else ""),
    ("ros", _ros_parameters),
    ("managed", lambda s: f"{_names(s.managed)}; Compose activates no nodes" if s.managed else ""),
    ("on_change", lambda s: f"{s.on_change}; Compose does not watch files" if s.on_change != "restart" else ""),
    ("priority", lambda s: str(s.priority) if s.priority != 50 else ""),
    ("resources", lambda s: _resources(s)),
    ("labels", lambda s: ", ".join(f"{k}: {v}" for k, v in sorted(s.labels.items()))),
)
"""Field of a Service -> what is lost of it; empty if it is not set. `labels` are those of metadata."""


def notes_of(catalog: Catalog) -> Iterator[Note]:
    """Notes on the robot first, then service by service."""
    for request in catalog.requests:
        names = " ".join(request.services)
        yield Note("", "Request", f"{request.id} of {request.requester}: `docker compose up --detach {names}`")
    profiled = profiles(catalog)
    for group in (catalog.groups[n] for n in sorted(catalog.groups)):
        if all(group.name in profiled.get(name, ()) for name in group.services):
            yield Note("", "Group", f"{group.name}: `docker compose --profile {group.name} up --detach`", lost=False)
        else:
            yield Note("", "Group", f"{group.name}: {', '.join(group.services)}")
    yield from _policy(catalog)
    yield from _images(catalog)
    for name in sorted(catalog.services):
        service = catalog.services[name]
        if service.spec is None and name != DEVELOPER:
            yield Note("", "Service", f"{name} is a meta-service: no container")
        if service.spec is not None:
            for field, say in SERVICE:
                if text := say(service):
                    yield Note(name, "metadata.labels" if field == "labels" else f"spec.{field}", text)
            yield from _unhealthy(service)


def _policy(catalog: Catalog) -> Iterator[Note]:
    policy = catalog.policy
    said = {"budget": policy.budget, "pressure": policy.pressure, "resources": policy.resources}
    if names := [name for name, value in said.items() if value]:
        yield Note("", "Policy", f"{', '.join(names)}: Compose does not manage the machine")


def _unhealthy(service: Service) -> Iterator[Note]:
    """Notes that Compose would wait forever for a service whose image has no health check."""
    if condition(service.ready) == "service_healthy" and not service.options.get("healthcheck"):
        yield Note(service.name, "spec.ready", "healthy by the check that its image must have", lost=False)


def _images(catalog: Catalog) -> Iterator[Note]:
    below = {name: [b for b in bases if b in catalog.images] for name, bases in stands_on(catalog.images).items()}
    needed = {base for own in below.values() for base in own}
    made = {declared(str(s.spec["image"]), catalog.images): n for n, s in sorted(catalog.services.items()) if s.spec}
    built = [n for n in parents_first(catalog.images) if n in needed and catalog.images[n].context is not None]
    if bases := [made.get(n, f"image-{stem(n)}") for n in built if not is_directory(catalog.images[n])]:
        text = f"Compose does not order builds; first run `docker compose build` for each of: {', '.join(bases)}"
        yield Note("", "Image", text, lost=False)
    for name, image in sorted(catalog.images.items()):
        if image.import_command:
            yield Note("", "Image", f"{name} is the output of a command: `{' '.join(image.import_command)}`")
        if image.secrets:
            yield Note("", "Image", f"{name}: {', '.join(image.secrets)} from the environment of Compose", lost=False)
