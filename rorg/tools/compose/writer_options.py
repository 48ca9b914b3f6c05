"""Translates the options of a rendered container into Compose.

There is one entry for each option of the `container:` section. A test fails if one is missing, so none is dropped
silently. The forms are those of the Compose Specification (services), https://github.com/compose-spec/compose-spec.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import Any

from rorg.model.options import OF_COMPOSE
from rorg.model.run_directory import RUN
from rorg.model.units import format_duration
from rorg.model.volumes import is_path
from rorg.tools.compose.writer_text import Note

Section = dict[str, Any]
CDI = "cdi"
"""The driver of devices of the Container Device Interface."""
SOCKET = "RORG_SOCKET"
"""The variable that tells a service where rorg is."""


class Writing:
    """The section of one service, with the notes and files that belong to it."""

    def __init__(
        self,
        service: str,
        containers: Mapping[str, str],
        networks: Mapping[str, str],
        volumes: Mapping[str, str],
        base: str,
    ) -> None:
        """`containers`: name of a container -> its service; `networks`, `volumes`: the engine's name -> the key in the
        Compose file; `base`: absolute directory of the Compose file."""
        self.service, self.containers, self.base = service, containers, base
        self.networks, self.volumes = networks, volumes
        self.section: Section = {}
        self.notes: list[Note] = []
        self.files: dict[str, str] = {}

    def note(self, option: str, text: str, lost: bool = True) -> None:
        self.notes.append(Note(self.service, f"spec.{option}", text, lost))

    def put(self, option: str, value: Any) -> None:
        self.section[option] = value

    def path(self, path: str) -> str:
        """A path of this machine: relative if it is below the Compose file's directory or its parent."""
        return beside(path, self.base)


def beside(path: str, base: str) -> str:
    """A path, relative to `base` if it is below that directory or its parent."""
    for root in (base, os.path.dirname(base)):
        if root != "/" and (path == root or path.startswith(f"{root}/")):
            inside = os.path.relpath(path, base)
            return inside if inside.startswith(".") else f"./{inside}"
    return path


Write = Callable[[Writing, str, Any], None]


def _same(writing: Writing, option: str, value: Any) -> None:
    writing.put(option, value)


def _seconds(writing: Writing, option: str, value: float) -> None:
    writing.put(option, format_duration(value))


def _no_word(text: str) -> Write:
    return lambda writing, option, _value: writing.note(f"container.{option}", text)


def _healthcheck(writing: Writing, option: str, value: Mapping[str, Any]) -> None:
    times = ("interval", "timeout", "start_period", "start_interval")
    writing.put(option, {k: format_duration(v) if k in times else v for k, v in value.items() if v is not None})


def _environment(writing: Writing, option: str, value: Mapping[str, str]) -> None:
    kept = {k: v for k, v in value.items() if RUN not in v}
    if kept:
        writing.put(option, kept)


def _devices(writing: Writing, option: str, value: list[str]) -> None:
    """Devices by path; Compose knows no other names for them."""
    kept = [device for device in value if device.startswith("/")]
    if kept:
        writing.put(option, kept)
    for device in (d for d in value if d not in kept):
        writing.note(f"container.{option}", f"Compose names devices only by path, which {device} is not")


def _gpus(writing: Writing, _option: str, value: list[Mapping[str, Any]]) -> None:
    """GPUs as reservations of devices, which every Compose of version 2 understands."""
    devices = []
    named = [name for gpu in value if gpu.get("driver") == CDI for name in gpu.get("device_ids") or ()]
    if named:
        writing.put("devices", [*writing.section.get("devices", ()), *named])
    for gpu in (gpu for gpu in value if gpu.get("driver") != CDI):
        device = {k: v for k, v in gpu.items() if v not in (None, {}, [])}
        if not device.get("device_ids"):
            device["count"] = "all" if device.get("count") in (None, -1, "all") else device["count"]
        devices.append({**device, "capabilities": list(dict.fromkeys([*gpu.get("capabilities", []), "gpu"]))})
    if devices:
        writing.put("deploy", {"resources": {"reservations": {"devices": devices}}})


def _links(writing: Writing, _option: str, value: list[str]) -> None:
    writing.put("external_links", value)
    writing.note("container.links", "these are names of containers, so they are external_links", lost=False)


def _joined(writing: Writing, option: str, value: str) -> None:
    """The namespace of another container; of its service, if that belongs to this robot."""
    kind, _, name = value.partition(":")
    if kind == "container" and name in writing.containers:
        value = f"service:{writing.containers[name]}"
    writing.put(option, value)


def _network_mode(writing: Writing, option: str, value: str) -> None:
    if value in writing.networks:
        writing.put("networks", {writing.networks[value]: None})
    else:
        _joined(writing, option, "bridge" if value == "default" else value)


def _networks(writing: Writing, _option: str, value: Mapping[str, Mapping[str, Any]]) -> None:
    if list(value) in (["bridge"], ["default"]):
        writing.put("network_mode", "bridge")
        return
    networks = {}
    for name, network in value.items():
        if name in writing.networks:
            networks[writing.networks[name]] = {k: v for k, v in network.items() if v not in (None, [], {})} or None
        else:
            writing.note(
                "container.networks", f"Compose cannot join other networks together with the engine's '{name}'"
            )
    writing.put("networks", networks)


def _no_network(writing: Writing, _option: str, value: bool) -> None:
    if value:
        writing.put("network_mode", "none")
        writing.note("container.network_disabled", "network_mode: none is the closest that Compose has", lost=False)


def _security(writing: Writing, option: str, values: list[str]) -> None:
    """Seccomp profiles become files, because Compose reads them only from files."""
    security_options = []
    for value in values:
        kind, _, text = value.partition("=")
        if kind == "seccomp" and text.startswith("{"):
            name = f"{writing.service}.seccomp.json"
            writing.files[name] = text
            value = f"seccomp:./{name}"
        security_options.append(value)
    writing.put(option, security_options)


def _volumes(writing: Writing, option: str, values: list[Any]) -> None:
    mounts: list[Any] = []
    for value in values:
        if isinstance(value, Mapping):
            source = value.get("source") or ""
            here = {"bind": writing.path(source), "volume": writing.volumes.get(source, source)}.get(value["type"])
            mounts.append({k: v for k, v in {**value, "source": here}.items() if v not in (None, "", {}, False)})
        elif not value.startswith(RUN):
            source, colon, rest = value.partition(":")
            if colon:
                source = writing.path(source) if is_path(source) else writing.volumes.get(source, source)
            mounts.append(source + colon + rest)
    if mounts:
        writing.put(option, mounts)


def _volumes_from(writing: Writing, option: str, values: list[str]) -> None:
    references = []
    for value in values:
        name, colon, mode = value.removeprefix("container:").partition(":")
        own = (
            name if name in writing.containers.values() and value.startswith(name) else writing.containers.get(name, "")
        )
        references.append((own or f"container:{name}") + colon + mode)
    writing.put(option, references)


def _ulimits(writing: Writing, option: str, value: Mapping[str, Mapping[str, int]]) -> None:
    writing.put(option, {k: v["soft"] if v["soft"] == v["hard"] else dict(v) for k, v in value.items()})


OPTIONS: Mapping[str, Write] = {
    **dict.fromkeys(OF_COMPOSE, _same),
    "cpuset_mems": _no_word("Compose has no setting for NUMA nodes"),
    "devices": _devices,
    "environment": _environment,
    "gpus": _gpus,
    "healthcheck": _healthcheck,
    "inherit_environment": _no_word("it is for the process engine"),
    "ipc": _joined,
    "links": _links,
    "masked_paths": _no_word("Compose cannot hide paths; security_opt: [systempaths=unconfined] hides none"),
    "network_disabled": _no_network,
    "network_mode": _network_mode,
    "networks": _networks,
    "pid": _joined,
    "publish_all_ports": _no_word("Compose publishes only ports that are listed; list them in `ports`"),
    "readonly_paths": _no_word("Compose has no such setting"),
    "security_opt": _security,
    "stop_grace_period": _seconds,
    "ulimits": _ulimits,
    "volume_driver": _no_word("Compose sets the driver of each volume at the top of the file"),
    "volumes": _volumes,
    "volumes_from": _volumes_from,
}
