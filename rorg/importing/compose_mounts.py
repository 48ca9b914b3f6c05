"""Volumes, configs and secrets of a Compose service, as volumes of a manifest."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rorg.importing.compose_keys import FILE, SERVICE_FILE
from rorg.importing.compose_work import SOUND, Work, size

BASES = {"configs": "/", "secrets": "/run/secrets/"}
"""Folders in the container for configs and secrets without an absolute target."""


def volumes(work: Work, name: str, value: list[Mapping[str, Any]]) -> list[Any]:
    """All volumes of one service."""
    found = [_volume(work, name, index, item) for index, item in enumerate(value)]
    return [item for item in found if item is not None]


def _volume(work: Work, name: str, index: int, said: Mapping[str, Any]) -> Any:
    place = ("services", name, "volumes", index)
    kind = said["type"]
    if kind == "tmpfs":
        return _tmpfs(said)
    if kind not in ("bind", "volume"):
        work.refuse(f"a volume of type {kind} cannot be carried over", *place, remedy="type: bind or volume")
        return None
    own = said.get(kind) or {}
    known = {"bind": ("create_host_path", "propagation", "selinux"), "volume": ("nocopy",)}[kind]
    for key in own:
        if key not in known and not key.startswith("x-") and own[key] not in (None, {}, [], "", False):
            message = f"{kind}.{key} of a volume cannot be carried over: rorg has no such option"
            work.refuse(message, *place, kind, key, remedy="dropping it")
    if kind == "bind":
        return _bind(work, said, own)
    source = work.called("volumes", said["source"]) if said.get("source") else ""
    return _named({**said, "source": source}, own)


def _bind(work: Work, said: Mapping[str, Any], own: Mapping[str, Any]) -> Any:
    source = work.local(said["source"])
    if own.get("create_host_path") and ":" not in source and source.startswith(("/", "./", "../")):
        modes = ["ro"] * bool(said.get("read_only")) + [own[k] for k in ("propagation", "selinux") if own.get(k)]
        modes += [said["consistency"]] if said.get("consistency") else []
        return ":".join([source, said["target"], *([",".join(modes)] if modes else [])])
    rest = {k: own[k] for k in ("propagation", "selinux") if own.get(k)}
    rest |= {"create_host_path": True} if own.get("create_host_path") else {}
    return _long("bind", {**said, "source": source}, rest)


def _named(said: Mapping[str, Any], own: Mapping[str, Any]) -> Any:
    source = said.get("source") or ""
    modes = ["ro"] * bool(said.get("read_only")) + ["nocopy"] * bool(own.get("nocopy"))
    if not source:
        return _long("volume", said, {"nocopy": True} if own.get("nocopy") else {}) if modes else said["target"]
    return ":".join([source, said["target"], *([",".join(modes)] if modes else [])])


def _tmpfs(said: Mapping[str, Any]) -> Any:
    own = {k: size(v) if k == "size" else v for k, v in (said.get("tmpfs") or {}).items() if k in ("size", "mode")}
    return _long("tmpfs", {k: v for k, v in said.items() if k != "source"}, own)


def _long(kind: str, said: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    found = {"type": kind, **{k: said[k] for k in ("source", "target") if said.get(k)}}
    found |= {"read_only": True} if said.get("read_only") else {}
    found |= {"consistency": said["consistency"]} if said.get("consistency") else {}
    return found | ({kind: dict(own)} if own else {})


def files_of(work: Work, name: str, section: str) -> list[Any]:
    """Mounts of the configs or secrets of a service. They become plain files of this machine."""
    declared = getattr(work.project, section)
    found = []
    for index, said in enumerate(work.project.services[name].get(section) or ()):
        place = ("services", name, section, index)
        work.check(SERVICE_FILE, said, *place, shown=f"{section}.")
        source = said["source"]
        path = _file(work, section, source, declared.get(source) or {})
        target = said.get("target") or source
        target = target if target.startswith("/") else BASES[section] + target
        if path:
            found.append({"type": "bind", "source": path, "target": target, "read_only": True})
            work.warn(f"{section[:-1]} {source} becomes the file {path}, mounted read-only", *place)
    return found


def _file(work: Work, section: str, source: str, said: Mapping[str, Any]) -> str:
    """The file as a service mounts it. Content from the Compose file or the environment is written to a new file."""
    work.check(FILE, said, section, source, shown=f"{section}.{source}.")
    if said.get("file"):
        return work.local(said["file"])
    if not SOUND.fullmatch(source):
        message = f"'{source}' is not a valid file name for one of the {section}"
        work.refuse(message, section, source, remedy="letters, digits, - _ and dots")
        return ""
    text = said.get("content")
    if said.get("environment"):
        text = work.environment.get(said["environment"])
        if text is None:
            message = f"{section}.{source}: the variable {said['environment']} is not set"
            work.refuse(message, section, source, "environment", remedy=f"{said['environment']}=... before the command")
    if text is None:
        return ""
    path = f"{section}/{source}"
    if section == "secrets" and path not in work.files:
        work.warn(
            f"{path} holds a secret in plain text",
            section,
            source,
            remedy="keeping it out of git",
        )
    work.files[path] = text
    work.private |= {path} if section == "secrets" else set()
    return f"../{path}"
