"""The body of the engine's create call for a rendered container (Docker API 1.41 and later).

There is one entry for each option of the `container:` section. A test fails if one is missing, so that none is dropped
silently.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rorg.model import options
from rorg.model.ports import parse_expose, parse_ports
from rorg.model.volumes import parse_device

Body = dict[str, Any]
NANO = 1_000_000_000
UNMASKED = "systempaths=unconfined"
OF_PROCESSES = frozenset(("inherit_environment",))
"""Options that are only for the process engine."""
BESIDE = ("container_name", "labels", "platform")
"""Options that are not part of the body: parameters of the call, and labels, which `create` adds."""


def _put(api: str, turn: Callable[[Any], Any] | None) -> Callable[[Body, Any], None]:
    part, _, key = api.rpartition(".")

    def put(body: Body, value: Any) -> None:
        (body[part] if part else body)[key] = turn(value) if turn else value

    return put


def _key_value(pairs: Mapping[str, str]) -> list[str]:
    return [f"{k}={v}" for k, v in sorted(pairs.items())]


def _nanoseconds(seconds: float | None) -> int:
    return round((seconds or 0) * NANO)


def _healthcheck(value: Mapping[str, Any]) -> Body:
    if value.get("disable"):
        return {"Test": ["NONE"]}
    return {
        "Test": value.get("test", []),
        "Interval": _nanoseconds(value.get("interval")),
        "Timeout": _nanoseconds(value.get("timeout")),
        "Retries": value.get("retries", 0),
        "StartPeriod": _nanoseconds(value.get("start_period")),
    }


def _device(text: str) -> Body:
    source, target, access = parse_device(text)
    return {"PathOnHost": source, "PathInContainer": target, "CgroupPermissions": access}


def _restart(text: str) -> Body:
    name, _, count = text.partition(":")
    return {"Name": name, "MaximumRetryCount": int(count or 0)}


def _gpu(value: Mapping[str, Any]) -> Body:
    count = value.get("count")
    return {
        "Driver": value.get("driver", ""),
        "Count": 0 if value.get("device_ids") else -1 if count in ("all", None) else count,
        "DeviceIDs": value.get("device_ids"),
        "Capabilities": [list(dict.fromkeys([*value.get("capabilities", []), "gpu"]))],
        "Options": value.get("options", {}),
    }


def _volumes(body: Body, values: list[Any]) -> None:
    for value in values:
        if isinstance(value, Mapping) and _as_bind(value):
            body["HostConfig"].setdefault("Binds", []).append(_as_bind(value))
        elif isinstance(value, Mapping):
            body["HostConfig"].setdefault("Mounts", []).append(_mount(value))
        elif ":" in value:
            body["HostConfig"].setdefault("Binds", []).append(value)
        else:
            body.setdefault("Volumes", {})[value] = {}


def _as_bind(value: Mapping[str, Any]) -> str:
    """A bind mount that needs the short form: for a long one, older engines create no directory on the host, and no
    engine takes SELinux labels."""
    bind = value.get("bind") or {}
    if not (value["type"] == "bind" and (bind.get("create_host_path") or bind.get("selinux"))):
        return ""
    modes = ["ro" if value.get("read_only") else "rw", bind.get("propagation"), bind.get("selinux")]
    return f"{value['source']}:{value['target']}:{','.join(m for m in modes if m)}"


def _mount(value: Mapping[str, Any]) -> Body:
    mount: Body = {
        "Type": value["type"],
        "Source": value.get("source", ""),
        "Target": value["target"],
        "ReadOnly": value.get("read_only", False),
    }
    if value.get("consistency"):
        mount["Consistency"] = value["consistency"]
    if value.get("bind"):
        mount["BindOptions"] = {"Propagation": value["bind"].get("propagation", "")}
    if value.get("volume"):
        mount["VolumeOptions"] = {"NoCopy": bool(value["volume"].get("nocopy"))}
    if value.get("tmpfs"):
        mount["TmpfsOptions"] = {{"size": "SizeBytes", "mode": "Mode"}[k]: v for k, v in value["tmpfs"].items()}
    return mount


def _ports(body: Body, values: list[str]) -> None:
    for published in (p for value in values for p in parse_ports(value)):
        body.setdefault("ExposedPorts", {})[published.port] = {}
        bindings = body["HostConfig"].setdefault("PortBindings", {}).setdefault(published.port, [])
        binding = {"HostIp": published.address, "HostPort": published.host}
        if binding not in bindings:
            bindings.append(binding)


def _expose(body: Body, values: list[str]) -> None:
    for port in (p for value in values for p in parse_expose(value)):
        body.setdefault("ExposedPorts", {})[port] = {}


def _security(body: Body, values: list[str]) -> None:
    """Unmasking paths of the system is left to clients, so it is no option of the engine."""
    body["HostConfig"]["SecurityOpt"] = [v for v in values if v != UNMASKED]
    if UNMASKED in values:
        body["HostConfig"]["MaskedPaths"] = body["HostConfig"]["ReadonlyPaths"] = []


def _blkio(body: Body, value: Mapping[str, Any]) -> None:
    host = body["HostConfig"]
    if value.get("weight") is not None:
        host["BlkioWeight"] = value["weight"]
    names = {
        "weight_device": "BlkioWeightDevice",
        "device_read_bps": "BlkioDeviceReadBps",
        "device_write_bps": "BlkioDeviceWriteBps",
        "device_read_iops": "BlkioDeviceReadIOps",
        "device_write_iops": "BlkioDeviceWriteIOps",
    }
    for key, name in names.items():
        if value.get(key):
            host[name] = [
                {"Path": e["path"], **({"Weight": e["weight"]} if "weight" in e else {"Rate": e["rate"]})}
                for e in value[key]
            ]


def _networks(body: Body, value: Mapping[str, Any]) -> None:
    """The container is created on the first network by name, as with Compose."""
    endpoints = {name: endpoint(network) for name, network in sorted(value.items())}
    if not endpoints:
        return
    first = min(endpoints)
    body["NetworkingConfig"] = {"EndpointsConfig": endpoints}
    body["HostConfig"].setdefault("NetworkMode", first)
    if endpoints[first]["MacAddress"]:  # older engines know only one for the container
        body.setdefault("MacAddress", endpoints[first]["MacAddress"])


def endpoint(network: Mapping[str, Any]) -> Body:
    """What a container is on one of its networks."""
    names = {"ipv4_address": "IPv4Address", "ipv6_address": "IPv6Address", "link_local_ips": "LinkLocalIPs"}
    return {
        "Aliases": network.get("aliases"),
        "IPAMConfig": {api: network[key] for key, api in names.items() if network.get(key)} or None,
        "MacAddress": network.get("mac_address", ""),
        "DriverOpts": network.get("driver_opts"),
    }


def _tmpfs(body: Body, values: list[str]) -> None:
    body["HostConfig"]["Tmpfs"] = {v.partition(":")[0]: v.partition(":")[2] for v in values}


_TURNS: Mapping[str, Callable[[Any], Any]] = {
    "cpus": lambda v: round(v * NANO),
    "devices": lambda v: [_device(d) for d in v],
    "environment": _key_value,
    "gpus": lambda v: [_gpu(g) for g in v],
    "healthcheck": _healthcheck,
    "logging": lambda v: {"Type": v.get("driver", "json-file"), "Config": v.get("options", {})},
    "restart": _restart,
    "stop_grace_period": lambda v: max(1, round(v)),
    "ulimits": lambda v: [{"Name": n, "Soft": u["soft"], "Hard": u["hard"]} for n, u in v.items()],
    "volumes_from": lambda v: [c.removeprefix("container:") for c in v],
}
"""Option -> its value in the API, if it differs from the one in manifests."""
OPTIONS: Mapping[str, Callable[[Body, Any], None]] = {
    **{name: _put(option.api, _TURNS.get(name)) for name, option in options.OPTIONS.items() if option.api},
    **dict.fromkeys(BESIDE, lambda _body, _value: None),
    "blkio_config": _blkio,
    "expose": _expose,
    "networks": _networks,
    "ports": _ports,
    "security_opt": _security,
    "tmpfs": _tmpfs,
    "volumes": _volumes,
}


def create_body(spec: Mapping[str, Any], labels: Mapping[str, str]) -> Body:
    """The body of POST /containers/create."""
    body: Body = {"HostConfig": {}, "Labels": dict(labels)}
    for option in sorted(spec.keys() - OF_PROCESSES):
        OPTIONS[option](body, spec[option])
    return body
