"""The spec of a Swarm service for a rendered container (Docker API 1.41 and later), and the options that it can take.

Swarm has no devices, privileges, pids, ipc or cpu sets: moby/swarmkit#1244, #2682.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rorg.engines.docker.body import NANO, Body, create_body
from rorg.model.ports import parse_ports
from rorg.model.volumes import OF_TREE, parse_tmpfs

RESTARTS = {"always": "any", "unless-stopped": "any", "on-failure": "on-failure", "no": "none"}
LEAST = 4 << 20
"""Bytes of memory that can be reserved or limited at least."""
DELAY = NANO
"""Nanoseconds between the end of a task and the next one."""
SHM = "/dev/shm"


def service_spec(name: str, spec: Mapping[str, Any], labels: Mapping[str, str], container: str) -> Body:
    """Return the spec of a service that does not run yet. `container` is the id of the container that it stands for;
    its tasks carry it too, so it is known which spec a task was made from."""
    made = create_body({k: v for k, v in spec.items() if k not in OWN}, {})
    inside, task = _inside(spec, made), _task(spec, made["HostConfig"])
    inside["Labels"] = {**labels, CONTAINER: container}
    ports = [port for value in spec.get("ports", ()) for port in _ports(value)]
    return {
        "Name": name,
        "Labels": {**labels, CONTAINER: container},
        "TaskTemplate": {"ContainerSpec": inside, **task},
        "Mode": {"Replicated": {"Replicas": 0}},
        "UpdateConfig": {"Parallelism": 1, "Order": "stop-first", "FailureAction": "continue"},
        **({"EndpointSpec": {"Mode": "vip", "Ports": ports}} if ports else {}),
    }


CONTAINER = "rorg.io/container"
"""The label with the id of the container that a spec stands for."""
OWN = ("placement", "reserve", "volumes", "tmpfs", "shm_size", "networks", "network_mode", "ports", "restart")
"""Options that have another form in a Swarm."""
_INSIDE: Mapping[str, str] = {
    "Image": "Image",
    "Entrypoint": "Command",
    "Cmd": "Args",
    "Env": "Env",
    "WorkingDir": "Dir",
    "User": "User",
    "Hostname": "Hostname",
    "StopSignal": "StopSignal",
    "Tty": "TTY",
    "OpenStdin": "OpenStdin",
    "Healthcheck": "HealthCheck",
}
"""Keys of the body of a container -> those of a task's."""
_FROM_HOST: Mapping[str, str] = {
    "CapAdd": "CapabilityAdd",
    "CapDrop": "CapabilityDrop",
    "GroupAdd": "Groups",
    "Init": "Init",
    "Isolation": "Isolation",
    "ReadonlyRootfs": "ReadOnly",
    "Sysctls": "Sysctls",
    "Ulimits": "Ulimits",
}
"""The same for its HostConfig."""


def _inside(spec: Mapping[str, Any], made: Body) -> Body:
    host = made["HostConfig"]
    inside = {there: made[here] for here, there in _INSIDE.items() if here in made}
    inside |= {there: host[here] for here, there in _FROM_HOST.items() if here in host}
    if "StopTimeout" in made:
        inside["StopGracePeriod"] = made["StopTimeout"] * NANO
    names = {"Nameservers": "Dns", "Search": "DnsSearch", "Options": "DnsOptions"}
    if dns := {there: host[here] for there, here in names.items() if host.get(here)}:
        inside["DNSConfig"] = dns
    if host.get("ExtraHosts"):
        inside["Hosts"] = [" ".join(reversed(entry.split(":", 1))) for entry in host["ExtraHosts"]]
    mounts = [mount for value in spec.get("volumes", ()) if (mount := _mount(value))]
    mounts += [_tmpfs(value) for value in spec.get("tmpfs", ())]
    if spec.get("shm_size"):
        mounts.append({"Type": "tmpfs", "Target": SHM, "TmpfsOptions": {"SizeBytes": spec["shm_size"]}})
    return {**inside, "Mounts": mounts}


def _mount(value: str | Mapping[str, Any]) -> Body | None:
    """A directory of the node; None for files that come with the service (see files.py)."""
    if isinstance(value, Mapping):
        if value["type"] == OF_TREE:
            return None
        made = create_body(
            {"volumes": [{**value, "bind": {**(value.get("bind") or {}), "create_host_path": False}}]}, {}
        )
        mounts: list[Body] = made["HostConfig"]["Mounts"]
        return mounts[0]
    source, target, *modes = value.split(":")
    return {"Type": "bind", "Source": source, "Target": target, "ReadOnly": "ro" in ",".join(modes).split(",")}


def _tmpfs(value: str) -> Body:
    return {"Type": "tmpfs", "Target": parse_tmpfs(value)[0]}


def _ports(value: str) -> list[Body]:
    """Every node accepts connections to a published port, and passes them on."""
    return [
        {
            "Protocol": port.port.partition("/")[2] or "tcp",
            "TargetPort": int(port.port.partition("/")[0]),
            **({"PublishedPort": int(port.host)} if port.host.isdigit() else {}),
        }
        for port in parse_ports(value)
    ]


def _task(spec: Mapping[str, Any], host: Body) -> Body:
    limits = {there: host[here] for here, there in _LIMITS.items() if host.get(here)}
    kept = spec.get("reserve") or {}
    reserved = {
        **({"NanoCPUs": round(kept["cpu"] * NANO)} if kept.get("cpu") else {}),
        **({"MemoryBytes": max(kept["memory"], LEAST)} if kept.get("memory") else {}),
    }
    name, _, count = str(spec.get("restart", "always")).partition(":")
    logging = host.get("LogConfig")
    return {
        "Resources": {"Limits": limits, "Reservations": reserved},
        "RestartPolicy": {
            "Condition": RESTARTS.get(name, "any"),
            "Delay": DELAY,
            **({"MaxAttempts": int(count)} if count else {}),
        },
        "Placement": {"Constraints": list(spec.get("placement", ()))},
        "Networks": _networks(spec),
        **({"LogDriver": {"Name": logging["Type"], "Options": logging["Config"]}} if logging else {}),
    }


_LIMITS: Mapping[str, str] = {"NanoCpus": "NanoCPUs", "Memory": "MemoryBytes", "PidsLimit": "Pids"}


def _networks(spec: Mapping[str, Any]) -> list[Body]:
    if spec.get("network_mode") in ("host", "none"):
        return [{"Target": spec["network_mode"]}]
    return [
        {"Target": name, "Aliases": (one or {}).get("aliases") or []} for name, one in spec.get("networks", {}).items()
    ]
