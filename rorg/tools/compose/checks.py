"""Checks a project as a whole: unknown names, cycles, options that exclude each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rorg.model.diagnostics import Diagnostic
from rorg.tools.compose.project import Place, Project
from rorg.tools.compose.variables import Suggestions

_SAME = (
    ("cpus", ("limits", "cpus")),
    ("mem_limit", ("limits", "memory")),
    ("pids_limit", ("limits", "pids")),
    ("mem_reservation", ("reservations", "memory")),
)
"""Keys that mean the same as one of deploy.resources, and must not contradict it."""
_GIVEN = {"configs": ("file", "environment", "content", "external"), "secrets": ("file", "environment", "external")}


def check(project: Project) -> list[Diagnostic]:
    """All findings, in no particular order."""
    checks = _Checks(project)
    for name, service in project.services.items():
        checks.service(name, service)
    for kind, ways in _GIVEN.items():
        for name, entry in getattr(project, kind).items():
            said = [way for way in ways if way in entry]
            if not said and "driver" not in entry:
                checks.error(f"{kind}.{name} does not say what it contains", f"one of {', '.join(ways)}", kind, name)
            elif len(said) > 1:
                message = f"{kind}.{name} says more than once what it contains: {' and '.join(said)}"
                checks.error(message, "one of these", kind, name, said[1])
    checks.rings()
    return checks.diagnostics


def needed(service: Mapping[str, Any]) -> Iterator[tuple[str, Place]]:
    """The other services that a service names, and where: Compose starts these first."""
    for other in service.get("depends_on", {}):
        yield other, ("depends_on", other)
    for key in ("network_mode", "ipc", "pid", "uts"):
        kind, _, other = str(service.get(key, "")).partition(":")
        if kind == "service":
            yield other, (key,)
    for index, link in enumerate(service.get("links", ())):
        yield link.partition(":")[0], ("links", index)
    for index, other in enumerate(service.get("volumes_from", ())):
        if not other.startswith("container:"):
            yield other.partition(":")[0], ("volumes_from", index)


class _Checks:
    def __init__(self, project: Project) -> None:
        self.project = project
        self.diagnostics: list[Diagnostic] = []
        self.near = Suggestions()

    def error(self, message: str, remedy: str, *path: str | int, severity: str = "error") -> None:
        self.diagnostics.append(Diagnostic(self.project.where(*path), message, remedy, severity))

    def service(self, name: str, service: Mapping[str, Any]) -> None:
        here = ("services", name)
        if not {"image", "build", "provider", "extends"} & set(service):
            self.error(
                f"service '{name}' has neither an image nor a build", "image: REFERENCE, or build: DIRECTORY", *here
            )
        self.needs(name, service)
        self.resources(name, service)
        if "network_mode" in service and service.get("networks"):
            message = f"service '{name}' has network_mode and networks, which exclude each other"
            self.error(message, "to remove one of them", *here, "network_mode")
        limits = service.get("deploy", {}).get("resources", {})
        for key, (side, inner) in _SAME:
            said = limits.get(side, {}).get(inner)
            if key in service and said is not None and said != service[key]:
                message = f"service '{name}' has different values for {key} and deploy.resources.{side}.{inner}"
                self.error(message, f"to remove {key}", *here, key)
        count = service.get("scale", service.get("deploy", {}).get("replicas", 1))
        if "scale" in service and service.get("deploy", {}).get("replicas", count) != count:
            self.error(
                f"service '{name}' has different values for scale and deploy.replicas", "one of them", *here, "scale"
            )
        if count > 1 and "container_name" in service:
            message = f"service '{name}' has {count} copies, but only one container can have the container_name"
            self.error(message, "to remove container_name", *here, "container_name")

    def needs(self, name: str, service: Mapping[str, Any]) -> None:
        known = self.project.services
        for other, path in needed(service):
            said = service["depends_on"][other] if path[0] == "depends_on" else {}
            if other not in known:
                required = said.get("required", True)
                severity = "error" if required else "warning"
                message = f"service '{name}' names service '{other}' in {path[0]}, which does not exist"
                self.error(message, self.near(other, known), "services", name, *path, severity=severity)
            elif name in self.project.enabled and other not in self.project.enabled and said.get("required", True):
                profiles = ", ".join(self.project.profiles[other])
                message = (
                    f"service '{name}' needs '{other}', which only profile {profiles} enables: Compose refuses that"
                )
                remedy = f"the profiles of '{other}' for '{name}', too"
                self.error(message, remedy, "services", name, *path, severity="warning")

    def resources(self, name: str, service: Mapping[str, Any]) -> None:
        """Checks the networks, volumes, configs and secrets that a service names."""
        named: list[tuple[str, str, Place]] = []
        for network in service.get("networks", {}):
            if not network.startswith("x-"):
                named.append(("networks", network, ("networks", network)))
        for index, volume in enumerate(service.get("volumes", ())):
            if volume.get("type") == "volume" and volume.get("source"):
                named.append(("volumes", volume["source"], ("volumes", index)))
        for kind in ("configs", "secrets"):
            for index, one in enumerate(service.get(kind, ())):
                named.append((kind, one.get("source", ""), (kind, index)))
        for index, one in enumerate(service.get("build", {}).get("secrets", ())):
            named.append(("secrets", one.get("source", ""), ("build", "secrets", index)))
        for kind, other, path in named:
            known = getattr(self.project, kind)
            if other not in known:
                message = f"service '{name}' names '{other}', which is not declared in {kind} at the top"
                remedy = self.near(other, known) or f"{kind}: {{{other}: ...}} at the top of the file"
                self.error(message, remedy, "services", name, *path)

    def rings(self) -> None:
        """Reports services that need each other, once for each cycle."""
        graph = {
            name: [o for o, _ in needed(s) if o in self.project.services] for name, s in self.project.services.items()
        }
        done: set[str] = set()
        for start in graph:
            ring = _ring(graph, start, done)
            if ring:
                message = f"services need each other: {' -> '.join(ring)}"
                path = dict(needed(self.project.services[ring[0]]))[ring[1]]
                self.error(message, "to remove one of these needs", "services", ring[0], *path)


def _ring(graph: Mapping[str, list[str]], start: str, done: set[str]) -> list[str]:
    """The first cycle reachable from `start`, without recursion. Services in `done` are not visited again."""
    path: list[str] = []
    above: set[str] = set()
    stack: list[tuple[str, bool]] = [(start, True)]
    while stack:
        name, entering = stack.pop()
        if not entering:
            above.discard(path.pop())
            done.add(name)
        elif name in above:
            done |= above
            return [*path[path.index(name) :], name]
        elif name not in done:
            path.append(name)
            above.add(name)
            stack.append((name, False))
            stack += [(other, True) for other in reversed(graph[name])]
    return []
