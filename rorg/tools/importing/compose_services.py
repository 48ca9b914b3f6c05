"""Services of Compose as manifests of kind Service, with their environment and the resources of their deployment."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from math import ceil
from pathlib import Path
from typing import Any

from rorg.manifest.dotenv import read_dotenv, values_of
from rorg.manifest.yaml_text import Inline, Noted
from rorg.model.diagnostics import Diagnostic
from rorg.model.units import format_duration
from rorg.tools.importing.compose_keys import DEPLOY, LIMIT, RESERVATION, SERVICE
from rorg.tools.importing.compose_mounts import files_of
from rorg.tools.importing.compose_options import options
from rorg.tools.importing.compose_work import Work, size
from rorg.tools.importing.manifests import NOTE, Made

HEALTHY, COMPLETED = "service_healthy", "service_completed_successfully"
RESTARTS = {"no": "never", "always": "always", "unless-stopped": "always"}
UNSET = "the default of Compose; rorg would always restart it"
INTERVAL, TIMEOUT, RETRIES = 30.0, 30.0, 3
"""The engine's defaults for health checks."""
LEAST = 60.0
"""Least number of seconds until a service that does not become healthy counts as late."""


def services(work: Work, images: Mapping[str, str]) -> list[Made]:
    """All services, one for each copy. `images`: the image that each runs."""
    _link(work)
    _rename(work)
    conditions = _conditions(work)
    return [made for name in work.project.services for made in _copies(work, name, images[name], conditions)]


def _link(work: Work) -> None:
    """Collects the names under which links know the services."""
    for name, said in work.project.services.items():
        for index, link in enumerate(said.get("links") or ()):
            other, _, alias = link.partition(":")
            if alias and alias != other:
                work.aliases.setdefault(other, []).append(alias)
                message = f"link {link}: {other} is also called {alias} in its networks, for every service in them"
                work.note(message, "services", name, "links", index)


def _rename(work: Work) -> None:
    """Gives services that share a container_name different names. Under Compose, they are alternatives: only one of
    them can run. A service that runs without a profile keeps the name."""
    owners: dict[str, list[str]] = {}
    services = work.project.services
    for name in sorted(services, key=lambda n: n not in work.project.enabled):
        if called := services[name].get("container_name"):
            owners.setdefault(called, []).append(name)
    for called, names in owners.items():
        for index, name in enumerate(names[1:], 1):
            own = work.renamed[name] = f"{work.project.name}-{name}-1"
            message = f"{names[0]} has the container_name {called}, too, so this container is called {own}"
            if not {name, *names[:index]} <= work.project.enabled:
                work.rivals[name] = names[:index]
                message += f", and {name} conflicts with {', '.join(names[:index])}"
            work.warn(message, "services", name, "container_name")


def _conditions(work: Work) -> dict[str, set[str]]:
    """Service -> the conditions that its dependants wait for."""
    conditions: dict[str, set[str]] = {}
    for said in work.project.services.values():
        for other, how in (said.get("depends_on") or {}).items():
            conditions.setdefault(other, set()).add(how.get("condition") or "")
    return conditions


def _copies(work: Work, name: str, image: str, conditions: Mapping[str, set[str]]) -> Iterator[Made]:
    before = len(work.found)
    spec = _spec(work, name, image, conditions.get(name, set()))
    comments = [
        f"From {work.origin('services', name)}, service {name}.",
        *work.unbuilt.get(name, ()),
        *work.told(before),
    ]
    made = Made("Service", name, spec, tuple(comments))
    copies = work.copies(name)
    if copies == 0:
        work.note("0 copies: the service is declared, but not requested", "services", name)
    for number in range(1, copies + 1) if copies > 1 else ():
        own = dict(spec, container={**spec["container"], "container_name": _called(work, name, number)})
        yield replace(made, name=f"{name}-{number}", spec=own)
    if copies <= 1:
        yield made


def _called(work: Work, name: str, number: int) -> Noted:
    said = work.renamed.get(name) or work.project.services[name].get("container_name")
    return Noted(said or f"{work.project.name}-{name}-{number}", "as Compose calls it")


def _spec(work: Work, name: str, image: str, awaited: set[str]) -> dict[str, Any]:
    said = work.project.services[name]
    work.check(SERVICE, said, "services", name)
    spec: dict[str, Any] = {"image": image}
    if said.get("command") is not None:
        spec["command"] = list(said["command"])
    if needs := _needs(work, name):
        spec["needs"] = needs
    if name in work.rivals:
        spec["conflicts"] = work.rivals[name]
    if ready := _ready(work, name, awaited):
        spec["ready"] = ready
    resources, limits = deploy_options(work, name)
    spec["restart"] = _restart(work, name, awaited)
    if resources:
        spec["resources"] = Inline(resources)
    container = {"container_name": _called(work, name, 1), **environment(work, name)}
    if labels := _labels(work, name):
        container["labels"] = labels
    container |= {k: v for k, v in options(work, name).items() if k != "container_name"}
    if "ipc" not in container and (users := _users_of_memory(work, name)):
        container["ipc"] = "shareable"
        message = f"ipc: shareable is added, which the engine requires for {', '.join(users)} to join it"
        work.warn(message, "services", users[0], "ipc")
    container |= limits
    mounts = [m for section in ("configs", "secrets") for m in files_of(work, name, section)]
    if mounts:
        container["volumes"] = [*container.get("volumes", ()), *mounts]
    spec["container"] = container
    return spec


def _users_of_memory(work: Work, name: str) -> list[str]:
    """Services that join the shared memory of this one."""
    return [other for other, said in work.project.services.items() if said.get("ipc") == f"service:{name}"]


def _needs(work: Work, name: str) -> list[Any]:
    said = work.project.services[name]
    needs: dict[str, Any] = {}
    for other, how in (said.get("depends_on") or {}).items():
        if other in work.project.services:
            needs[other] = {"service": other, "restart": True} if how.get("restart") else other
    for link in said.get("links") or ():
        other = link.partition(":")[0]
        needs.setdefault(other, other)
    return list(needs.values())


def _ready(work: Work, name: str, awaited: set[str]) -> Any:
    """The readiness that the service's dependants wait for."""
    if COMPLETED in awaited:
        if HEALTHY in awaited:
            message = f"some wait until {name} is healthy, some until it has ended: now all of them wait for its end"
            work.warn(message, "services", name)
        return Inline({"completed": True})
    if HEALTHY not in awaited:
        return None
    if "service_started" in awaited:
        work.note(f"every service that needs {name} waits until it is healthy", "services", name)
    check = work.project.services[name].get("healthcheck") or {}
    interval, timeout = check.get("interval", INTERVAL), check.get("timeout", TIMEOUT)
    longest = check.get("start_period", 0.0) + (check.get("retries", RETRIES) + 1) * (interval + timeout)
    return Inline({"engine": "healthy", "timeout": format_duration(float(ceil(max(LEAST, longest))))})


def _restart(work: Work, name: str, awaited: set[str]) -> Any:
    said = work.project.services[name]
    place: tuple[str, ...] = ("services", name, "restart")
    written = said.get("restart")
    if written is None and (policy := (said.get("deploy") or {}).get("restart_policy")):
        place = ("services", name, "deploy", "restart_policy")
        written = {"none": "no", "on-failure": "on-failure"}.get(policy.get("condition") or "any", "always")
        if set(policy) - {"condition"}:
            work.note("rorg restarts without limit, with growing delays", *place)
    if written is None:
        return Noted("never", UNSET)
    kind, colon, _ = str(written).partition(":")
    if colon:
        work.note(f"restart: {written}: rorg restarts without limit, with growing delays", *place)
    restart = "on-failure" if kind == "on-failure" else RESTARTS.get(kind, "always")
    if restart == "always" and COMPLETED in awaited:
        message = f"some services wait until {name} has ended, so it is restarted only if it fails"
        work.warn(message, *place)
        return "on-failure"
    return restart


def _labels(work: Work, name: str) -> dict[str, str]:
    """Labels of the service and, if it is built, those of its image, which its containers inherit."""
    said = work.project.services[name]
    built = (said.get("build") or {}).get("labels") or {}
    if built:
        work.note("labels of the image become labels of the container", "services", name, "build", "labels")
    labels = {**built, **(said.get("labels") or {})}
    for key in labels:
        if key.startswith("rorg.io/"):
            work.refuse(f"the label {key} is reserved for rorg", "services", name, "labels", key, remedy="another name")
    return {key: str(value) for key, value in labels.items() if not key.startswith("rorg.io/")}


def deploy_options(work: Work, name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """(`resources` of the service, options of its container) from `deploy`, as far as it concerns more than a swarm."""
    said = work.project.services[name].get("deploy") or {}
    place = ("services", name, "deploy")
    work.check(DEPLOY, said, *place, shown="deploy.")
    resources = said.get("resources") or {}
    limits, reserved = resources.get("limits") or {}, resources.get("reservations") or {}
    for part, own, table in (("limits", limits, LIMIT), ("reservations", reserved, RESERVATION)):
        work.check(table, own, *place, "resources", part, shown=f"deploy.resources.{part}.")
    memory = size(reserved.get("memory", 0))
    container = {
        "cpus": limits.get("cpus"),
        "mem_limit": size(limits.get("memory", 0)),
        "pids_limit": limits.get("pids"),
        "mem_reservation": memory,
    }
    reservations = {"cpu": reserved.get("cpus"), "memory": memory}
    return {k: v for k, v in reservations.items() if v}, {k: v for k, v in container.items() if v}


def environment(work: Work, name: str) -> dict[str, Any]:
    """`env_file` and `environment` of the container. An env file stays a file if rorg reads it as Compose does;
    otherwise its values are written out."""
    said: Mapping[str, Any] = work.project.services[name].get("environment") or {}
    for key, value in said.items():
        if value is None:
            message = f"{key} is not set anywhere, so the container does not have it, as with Compose"
            work.note(message, "services", name, "environment", key)
    values = {key: str(value) for key, value in said.items() if value is not None}
    names, of_files = _files(work, name)
    container_options: dict[str, Any] = {"env_file": names} if names else {}
    own = {key: value for key, value in values.items() if of_files.get(key) != value}
    return container_options | ({"environment": own} if own else {})


def _files(work: Work, name: str) -> tuple[list[Any], dict[str, str]]:
    """(env files as the manifest names them, the values that they set). Empty if a value contains a variable, because
    only Compose knows how to fill that in."""
    listed, values = list[Any](), dict[str, str]()
    for item in work.project.services[name].get("env_file") or ():
        path, raw = item["path"], item.get("format") == "raw"
        text = work.read(Path(path))
        if text is None:
            listed.append({"path": work.local(path), "required": False})
            continue
        if "$" in text or raw:
            return [], {}
        entries, mistakes = read_dotenv(text, lambda _: None)
        if mistakes or any(entry.bare for entry in entries):
            return [], {}
        values |= values_of(entries)
        listed.append(work.local(path) if item.get("required", True) else {"path": work.local(path), "required": False})
    if any(work.project.services[name]["environment"].get(key) is None for key in values):
        return [], {}
    return listed, values


def fixed_variables(work: Work) -> list[Diagnostic]:
    """One note for each variable whose value from the process's environment is now in the manifests."""
    users: dict[str, list[tuple[str | int, ...]]] = {}
    for place, names in work.project.taken.items():
        for name in names:
            users.setdefault(name, []).append(place)
    notes = []
    for name, variable in work.project.variables.items():
        if variable.value is None or variable.file is not None or name not in users:
            continue
        services = dict.fromkeys(str(p[1]) for p in users[name] if p[0] == "services" and len(p) > 1)
        where = f" in {', '.join(services)}" if services else ""
        message = f"{name} was taken from the environment: its current value is now fixed{where}"
        notes.append(Diagnostic(work.project.where(*users[name][0]), message, "", NOTE))
    return notes
