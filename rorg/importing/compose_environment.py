"""The environment of a service: env files stay files where rorg reads them as Compose does; the rest is written out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rorg.importing.compose_work import Work
from rorg.importing.manifests import NOTE
from rorg.manifest.dotenv import read_dotenv, values_of
from rorg.model.diagnostics import Diagnostic

Read = Callable[[Path], str]


def environment(work: Work, name: str) -> dict[str, Any]:
    """`env_file` and `environment` of the container."""
    said: Mapping[str, Any] = work.project.services[name].get("environment") or {}
    for key, value in said.items():
        if value is None:
            message = f"{key} is set nowhere, so that the container has none, as with Compose"
            work.note(message, "services", name, "environment", key)
    values = {key: str(value) for key, value in said.items() if value is not None}
    names, of_files = _files(work, name)
    found: dict[str, Any] = {"env_file": names} if names else {}
    own = {key: value for key, value in values.items() if of_files.get(key) != value}
    return found | ({"environment": own} if own else {})


def _files(work: Work, name: str) -> tuple[list[Any], dict[str, str]]:
    """(env files as the manifest names them, what they set). None where a value in them is filled in, which only
    Compose knows how."""
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


def taken(work: Work) -> list[Diagnostic]:
    """One note for each variable that the process's environment has set: its value stands in the manifests now."""
    users: dict[str, list[tuple[str | int, ...]]] = {}
    for place, names in work.project.taken.items():
        for name in names:
            users.setdefault(name, []).append(place)
    found = []
    for name, variable in work.project.variables.items():
        if variable.value is None or variable.file is not None or name not in users:
            continue
        services = dict.fromkeys(str(p[1]) for p in users[name] if p[0] == "services" and len(p) > 1)
        where = f" in {', '.join(services)}" if services else ""
        message = f"{name} was taken from the environment: its value of now stands{where}"
        found.append(Diagnostic(work.project.where(*users[name][0]), message, "", NOTE))
    return found
