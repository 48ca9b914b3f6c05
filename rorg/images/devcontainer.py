"""A dev container for editors: .devcontainer/devcontainer.json (https://containers.dev/implementors/json_reference).

Editors create a container of their own from it, with the flags of `docker run`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

MARK = "rorg"
"""Key below `customizations`: it marks files that rorg wrote."""
_SAME = (
    *("cap_add", "cap_drop", "cgroup_parent", "cpu_period", "cpu_quota", "cpu_rt_period", "cpu_rt_runtime"),
    *("cpu_shares", "cpus", "cpuset_mems", "dns", "dns_search", "domainname", "expose", "group_add", "hostname", "ipc"),
    *("isolation", "oom_score_adj", "pid", "pids_limit", "platform", "runtime", "security_opt", "shm_size"),
    *("stop_signal", "tmpfs", "uts", "volumes_from"),
)
FLAGS = {
    **{name: name.replace("_", "-") for name in _SAME},
    "cgroup": "cgroupns",
    "cpuset": "cpuset-cpus",
    "device_cgroup_rules": "device-cgroup-rule",
    "devices": "device",
    "dns_opt": "dns-option",
    "extra_hosts": "add-host",
    "links": "link",
    "mem_limit": "memory",
    "mem_reservation": "memory-reservation",
    "mem_swappiness": "memory-swappiness",
    "memswap_limit": "memory-swap",
    "network_mode": "network",
    "userns_mode": "userns",
}
"""Options whose value, or each item of it, is the value of a flag."""
SWITCHES = ("init", "oom_kill_disable", "privileged", "read_only")
PAIRS = {"annotations": "annotation", "storage_opt": "storage-opt", "sysctls": "sysctl"}
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
    found = {
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
    return found, left


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
    """Flags of `docker run` for an option; empty if there is none."""
    if option in SWITCHES:
        return [f"--{option.replace('_', '-')}"] if value else []
    if option in FLAGS:
        return [f"--{FLAGS[option]}={v}" for v in (value if isinstance(value, list) else [value])]
    if option in PAIRS:
        return [f"--{PAIRS[option]}={k}={v}" for k, v in value.items()]
    if option == "ulimits":
        return [f"--ulimit={name}={limit['soft']}:{limit['hard']}" for name, limit in value.items()]
    if option == "networks":
        return [f"--network={name}" for name in sorted(value)]
    if option == "gpus":
        return [f"--gpus={_gpu(v)}" for v in value]
    if option == "logging":
        options = [f"--log-opt={k}={v}" for k, v in value.get("options", {}).items()]
        return [f"--log-driver={value.get('driver', 'json-file')}", *options]
    return []


def _gpu(value: Mapping[str, Any]) -> str:
    if value.get("device_ids"):
        return f'"device={",".join(value["device_ids"])}"'
    return "all" if value.get("count") in ("all", None, -1) else str(value["count"])
