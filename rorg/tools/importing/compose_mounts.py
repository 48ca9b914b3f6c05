"""Volumes, configs and secrets of a Compose service, as volumes of a manifest."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rorg.tools.compose.project import VALUE
from rorg.tools.importing.compose_keys import FILE, SERVICE_FILE
from rorg.tools.importing.compose_work import SOUND, Step, Work, nonempty, size

BASES = {"configs": "/", "secrets": "/run/secrets/"}
"""Folders in the container for configs and secrets without an absolute target."""


OWN = {
    "bind": ("propagation", "selinux", "create_host_path"),
    "volume": ("nocopy",),
    "tmpfs": ("size", "mode"),
}
"""Type of a volume -> its own options that rorg has, too."""


def volumes(work: Work, name: str, value: list[Mapping[str, Any]]) -> list[Any]:
    """All volumes of one service."""
    mounts = [_volume(work, item, ("services", name, "volumes", index)) for index, item in enumerate(value)]
    return [item for item in mounts if item is not None]


def _volume(work: Work, said: Mapping[str, Any], place: tuple[Step, ...]) -> Any:
    """A volume in its short form, `SOURCE:TARGET:MODES`, if that can express it."""
    kind, target, source = said["type"], said["target"], said.get("source") or ""
    if kind not in OWN:
        work.refuse(f"a volume of type {kind} cannot be carried over", *place, remedy="type: bind or volume")
        return None
    if not target.startswith("/"):
        message = f"'{target}' is not an absolute path in the container, so the engine refuses this volume"
        work.refuse(message, *place, remedy="SOURCE:/PATH")
        return None
    own = {key: one for key, one in nonempty(said.get(kind) or {}).items() if one is not False}
    for key in own:
        if key not in OWN[kind] and not key.startswith("x-"):
            message = f"{kind}.{key} of a volume cannot be carried over: rorg has no such option"
            work.refuse(message, *place, kind, key, remedy="to drop it")
    own = {key: own[key] for key in OWN[kind] if key in own}
    modes = ["ro"] * bool(said.get("read_only"))
    if kind == "bind":
        source = work.local(source)
        modes += [own[key] for key in ("propagation", "selinux") if key in own]
        modes += [said["consistency"]] if said.get("consistency") else []
        short = "create_host_path" in own and ":" not in source and source.startswith(("/", "./", "../"))
    elif kind == "volume":
        source = work.called("volumes", source) if source else ""
        if said.get("consistency"):
            work.note("consistency has no effect on a named volume, so it is left out", *place, "consistency")
        modes += own.keys()
        short = bool(source)
        if not source and not modes:
            return target
    else:
        own |= {"size": size(own["size"])} if "size" in own else {}
        source, short = "", False
    if short:
        return ":".join([source, target, *([",".join(modes)] if modes else [])])
    long = {"type": kind, "source": source, "target": target, "read_only": said.get("read_only") or None}
    consistency = said.get("consistency") if kind == "bind" else None
    return nonempty({**long, "consistency": consistency, kind: own})


def files_of(work: Work, name: str, section: str) -> list[Any]:
    """Mounts of the configs or secrets of a service. They become plain files of this machine."""
    declared = getattr(work.project, section)
    mounts = []
    for index, said in enumerate(work.project.services[name].get(section) or ()):
        place = ("services", name, section, index)
        work.check(SERVICE_FILE, said, *place, shown=f"{section}.")
        source = said["source"]
        path = _file(work, section, source, declared.get(source) or {})
        target = said.get("target") or source
        target = target if target.startswith("/") else BASES[section] + target
        if path:
            mounts.append({"type": "bind", "source": path, "target": target, "read_only": True})
            work.warn(f"{section[:-1]} {source} becomes the file {path}, mounted read-only", *place)
    return mounts


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
        text = said[VALUE]
        if text is None:
            message = f"{section}.{source}: the variable {said['environment']} is not set"
            work.refuse(message, section, source, "environment", remedy=f"{said['environment']}=... before the command")
    if text is None:
        return ""
    path = f"{section}/{source}"
    if section == "secrets" and path not in work.files:
        work.warn(f"{path} holds a secret in plain text", section, source, remedy="to keep it out of git")
    work.files[path] = text
    work.private |= {path} if section == "secrets" else set()
    return f"../{path}"
