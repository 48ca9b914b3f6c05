"""A dev container for editors: .devcontainer/devcontainer.json (https://containers.dev/implementors/json_reference).

Editors create a container of their own from it, with the flags of `docker run`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from rorg.model.options import OPTIONS

MARK = "rorg"
"""Key below `customizations`: it marks files that rorg wrote."""
ELSEWHERE = frozenset(
    ("image", "volumes", "environment", "user", "working_dir", "command", "entrypoint", "stdin_open", "healthcheck")
)
"""Options with a key of their own in the document, and options that the editor controls."""


def document(name: str, of: str, spec: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """(the document, options of the spec that it cannot express)."""
    workspace, volumes = spec["working_dir"], spec["volumes"]
    lines = [v for v in volumes if isinstance(v, str)]
    mounts = {v["target"]: _mount(v) for v in volumes if not isinstance(v, str)}
    flags = [flag for option in sorted(spec.keys() - ELSEWHERE) for flag in _flags(option, spec[option])]
    left = sorted(o for o in spec.keys() - ELSEWHERE if spec[o] not in (None, False, [], {}) and not _flags(o, spec[o]))
    properties = {
        "name": name,
        "image": spec["image"],
        "workspaceFolder": workspace,
        "workspaceMount": mounts.pop(workspace),
        "mounts": list(mounts.values()),
        "runArgs": [*flags, *(f"--volume={line}" for line in lines), "--no-healthcheck"],
        "containerEnv": dict(spec["environment"]),
        "containerUser": spec["user"],
        "remoteUser": spec["user"],
        "updateRemoteUserUID": False,
        "overrideCommand": True,
        "customizations": {MARK: {"of": of}},
    }
    return properties, left


def written_by_rorg(text: bytes) -> bool:
    """Whether rorg wrote a file. A file with comments is not rorg's."""
    try:
        return MARK in json.loads(text)["customizations"]
    except (ValueError, LookupError, TypeError, RecursionError):
        return False


def _mount(volume: Mapping[str, Any]) -> str:
    words = [f"type={volume['type']}", *([f"source={volume['source']}"] if volume.get("source") else [])]
    return ",".join([*words, f"target={volume['target']}", *(["readonly"] if volume.get("read_only") else [])])


def _flags(option: str, value: Any) -> list[str]:
    """The flags of `docker run` for an option; none if it has no flag."""
    if option == "ulimits":
        return [f"--ulimit={name}={limit['soft']}:{limit['hard']}" for name, limit in value.items()]
    if option == "networks":
        return [f"--network={name}" for name in sorted(value)]
    if option == "gpus":
        return [f"--gpus={_gpu(v)}" for v in value]
    if option == "logging":
        options = [f"--log-opt={k}={v}" for k, v in value.get("options", {}).items()]
        return [f"--log-driver={value.get('driver', 'json-file')}", *options]
    flag = OPTIONS[option].flag if option in OPTIONS else ""
    if not flag or isinstance(value, bool):
        return [f"--{flag}"] if flag and value else []
    if isinstance(value, Mapping):
        return [f"--{flag}={k}={v}" for k, v in value.items()]
    return [f"--{flag}={v}" for v in (value if isinstance(value, list) else [value])]


def _gpu(value: Mapping[str, Any]) -> str:
    if value.get("device_ids"):
        return f'"device={",".join(value["device_ids"])}"'
    return "all" if value.get("count") in ("all", None, -1) else str(value["count"])
