"""The cases of Compose files (tests/cases/compose): what we read, and what Compose itself says, in one form."""

from __future__ import annotations

import json
import re
from argparse import ArgumentParser
from pathlib import Path
from typing import Any

from common import ROOT
from record import arguments_of, environment_of

from rorg.tools.compose import Loaded, Project, load
from rorg.tools.compose.checks import needed

CASES = ROOT / "tests/cases/compose"

SIZES = {"mem_limit", "mem_reservation", "memswap_limit", "shm_size", "memory", "mem_swappiness", "Rate", "rate"}
DURATIONS = {"stop_grace_period", "interval", "timeout", "start_period", "start_interval", "delay", "window", "monitor"}
SECONDS = {"h": 3600.0, "m": 60.0, "s": 1.0, "ms": 0.001, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
OWN = {"env_file", "label_file"}
"""Kept by us, and left out by Compose once it has read them."""
OPEN = {"environment", "args"}
"""What is null in them matters."""


def cases() -> list[str]:
    return sorted(path.name for path in CASES.iterdir() if (path / "config.json").exists())


def load_case(name: str) -> Loaded:
    return load_from(CASES / name)


def load_from(case: Path, profiles: tuple[str, ...] = ()) -> Loaded:
    """A case that lies anywhere, with these profiles beside its own."""
    parser = ArgumentParser()
    parser.add_argument("-f", "--file", action="append", default=[])
    parser.add_argument("--profile", action="append", default=[])
    parser.add_argument("--env-file", action="append")
    parser.add_argument("-p", "--project-name")
    parser.add_argument("--project-directory")
    said = parser.parse_args(arguments_of(case))
    return load(
        [case / file for file in said.file] or [case],
        environment_of(case),
        directory=case / said.project_directory if said.project_directory else None,
        env_files=[case / file for file in said.env_file] if said.env_file else None,
        profiles=[*said.profile, *profiles],
        name=said.project_name,
    )


def theirs(name: str) -> dict[str, Any]:
    """What Compose says, in the common form."""
    text = (CASES / name / "config.json").read_text().replace("CASE", str(CASES / name))
    found = json.loads(text)
    return {kind: _section(found.get(kind) or {}, dollars=True) for kind in SECTIONS} | {"name": found["name"]}


def ours(project: Project) -> dict[str, Any]:
    """What we say, in the common form: without what nothing enables or uses."""
    services = {name: _implied(dict(project.services[name])) for name in project.services if name in project.enabled}
    found = {"services": services, **{kind: _used(project, kind, services) for kind in SECTIONS[1:]}}
    return {kind: _section(entries) for kind, entries in found.items()} | {"name": project.name}


def _section(entries: dict[str, Any], dollars: bool = False) -> dict[str, Any]:
    """By name, whatever the names begin with."""
    common = {name: _common(value, dollars=dollars) for name, value in entries.items()}
    return {name: value for name, value in common.items() if value not in (None, {}, [], "", False)}


SECTIONS = ("services", "networks", "volumes", "configs", "secrets")


def _implied(service: dict[str, Any]) -> dict[str, Any]:
    """With the dependencies that Compose adds of itself."""
    found = dict(service.get("depends_on", {}))
    for other, path in needed(service):
        again = {"restart": True} if path[0] != "volumes_from" else {}
        found.setdefault(other, {"condition": "service_started", "required": True, **again})
    return {**service, "depends_on": found}


def _used(project: Project, kind: str, services: dict[str, Any]) -> dict[str, Any]:
    used: set[str] = set()
    for service in services.values():
        listed = service.get(kind) or {}
        used |= set(listed) if isinstance(listed, dict) else {one.get("source") for one in listed}
        if kind == "secrets":
            used |= {one.get("source") for one in service.get("build", {}).get("secrets", ())}
    return {name: entry for name, entry in getattr(project, kind).items() if name in used}


def _seconds(text: str) -> float:
    return sum(float(n) * SECONDS[unit] for n, unit in re.findall(r"([0-9.]+)(h|ms|us|µs|ns|m|s)", text))


def _key(key: str, dollars: bool) -> str:
    """As the specification writes it; Compose's answer has a few with capitals."""
    key = key.lower() if key in ("Path", "Rate", "Weight") else key
    return key.replace("$$", "$") if dollars else key


def _common(value: Any, key: str = "", dollars: bool = False) -> Any:
    if isinstance(value, dict):
        inner = {_key(k, dollars): _common(v, k, dollars) for k, v in value.items()}
        if key in OPEN:
            return inner
        inner = {k: v for k, v in inner.items() if k not in OWN and not k.startswith("x-")}
        return {k: v for k, v in inner.items() if v not in (None, {}, [], "", False)}
    if isinstance(value, list):
        listed = [_common(one, dollars=dollars) for one in value]
        return sorted(listed) if key == "extra_hosts" else listed
    if key in SIZES or (key == "size" and not isinstance(value, dict)):
        return int(value) if str(value).lstrip("-").isdigit() else value
    if key in DURATIONS and isinstance(value, str):
        return _seconds(value)
    return value.replace("$$", "$") if dollars and isinstance(value, str) else value


def differences(left: Any, right: Any, path: str = "") -> list[str]:
    """Where two values are not the same."""
    if isinstance(left, dict) and isinstance(right, dict):
        keys = [*left, *(key for key in right if key not in left)]
        return [d for k in keys for d in differences(left.get(k, "-"), right.get(k, "-"), f"{path}.{k}")]
    return [] if left == right else [f"{path}: ours {left!r}, Compose's {right!r}"]
