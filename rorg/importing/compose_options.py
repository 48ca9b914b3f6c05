"""The options of one service of Compose as the `container` section of a manifest. What Compose and rorg call alike is
taken as it is; the rest has a function here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rorg.importing.compose_keys import HEALTHCHECK, SERVICE, SERVICE_NETWORK
from rorg.importing.compose_mounts import volumes
from rorg.importing.compose_work import Work, duration, size

ELSEWHERE = frozenset(("env_file", "environment", "labels", "container_name"))
"""Carried over beside the others, since more than one key makes them."""


def options(work: Work, name: str) -> dict[str, Any]:
    """All that is carried over of a service, in the order of the table."""
    said = work.project.services[name]
    found: dict[str, Any] = {}
    for key, row in SERVICE.items():
        if row.how == "carried" and key not in ELSEWHERE and said.get(key) is not None:
            turn = FORMS.get(key)
            value = turn(work, name, said[key]) if turn else said[key]
            if value not in ({}, []) or key == "entrypoint":
                found[key] = value
    return found


def _sizes(work: Work, name: str, value: Any) -> Any:
    return size(value)


def _duration(work: Work, name: str, value: Any) -> Any:
    return duration(value)


def _texts(work: Work, name: str, value: Any) -> Any:
    return [str(item) for item in value]


def _rates(work: Work, name: str, value: Mapping[str, Any]) -> Any:
    found = dict(value)
    for key, items in value.items():
        if isinstance(items, list):
            found[key] = [{**item, "rate": size(item["rate"])} if "rate" in item else dict(item) for item in items]
    return found


def _devices(work: Work, name: str, value: list[Any]) -> Any:
    return [_device(item) if isinstance(item, Mapping) else item for item in value]


def _device(item: Mapping[str, Any]) -> str:
    source, access = item["source"], item.get("permissions") or "rwm"
    target = item.get("target") or source
    if access != "rwm":
        return f"{source}:{target}:{access}"
    return str(source) if target == source else f"{source}:{target}"


def _hosts(work: Work, name: str, value: Any) -> Any:
    if not isinstance(value, Mapping):
        return [str(line).replace("=", ":", 1) for line in value]
    return [f"{host}:{address}" for host, found in value.items() for address in ([found] if isinstance(found, str) else found)]


def _gpus(work: Work, name: str, value: Any) -> Any:
    return gpus(value)


def gpus(value: Any) -> Any:
    """Requests of `gpus`, or of devices of a deployment, as one of a container."""
    if not isinstance(value, list):
        return value
    return [{k: "all" if k == "count" and v == -1 else v for k, v in item.items()} for item in value]


def _healthcheck(work: Work, name: str, value: Mapping[str, Any]) -> Any:
    work.check(HEALTHCHECK, value, "services", name, "healthcheck", shown="healthcheck.")
    carried = {k: v for k, v in value.items() if k in HEALTHCHECK and HEALTHCHECK[k].how == "carried"}
    if carried.get("disable"):
        return {"disable": True}
    return {k: duration(v) if k in ("interval", "timeout", "start_period") else v for k, v in carried.items() if v is not None}


def _ports(work: Work, name: str, value: list[Any]) -> Any:
    return [_port(item) if isinstance(item, Mapping) else str(item) for item in value]


def _port(item: Mapping[str, Any]) -> str:
    address = item.get("host_ip") or ""
    address = f"[{address}]" if ":" in address else address
    published, protocol = str(item.get("published") or ""), item.get("protocol") or "tcp"
    inside = f"{item['target']}" + (f"/{protocol}" if protocol != "tcp" else "")
    if address:
        return f"{address}:{published}:{inside}"
    return f"{published}:{inside}" if published else inside


def _networks(work: Work, name: str, value: Mapping[str, Any]) -> Any:
    """Every network with the service's name as an alias: that is how others find it under Compose."""
    found = {}
    for network, said in value.items():
        work.check(SERVICE_NETWORK, said or {}, "services", name, "networks", network, shown=f"networks.{network}.")
        own = {k: v for k, v in (said or {}).items() if k in SERVICE_NETWORK and SERVICE_NETWORK[k].how == "carried"}
        names = dict.fromkeys([name, *(own.pop("aliases", None) or ()), *work.aliases.get(name, ())])
        found[network] = {"aliases": list(names), **{k: v for k, v in own.items() if v not in (None, [], {})}}
    return found


def _namespace(work: Work, name: str, value: str) -> Any:
    """service:NAME means one container, also where NAME has several."""
    kind, colon, other = value.partition(":")
    return f"service:{work.first(other)}" if kind == "service" and colon else value


def _volumes_from(work: Work, name: str, value: list[str]) -> Any:
    found = []
    for item in value:
        other, colon, access = item.partition(":")
        found.append(item if other == "container" else f"{work.first(other)}{colon}{access}")
    return found


def _security(work: Work, name: str, value: list[str]) -> Any:
    found = []
    for item in value:
        kind, sign, profile = item.partition("=") if "=" in item else item.partition(":")
        if kind == "seccomp" and profile not in ("unconfined", "builtin", "") and not profile.startswith("{"):
            item = f"seccomp={work.local(str(work.project.directory / profile))}"
        found.append(item)
    return found


def _isolation(work: Work, name: str, value: str) -> Any:
    if value != "default":
        message = f"isolation: {value} cannot be carried over: it is for Windows"
        work.refuse(message, "services", name, "isolation", remedy="dropping it")
    return value


FORMS: Mapping[str, Callable[[Work, str, Any], Any]] = {
    "blkio_config": _rates,
    "cpus": lambda work, name, value: float(value),
    "devices": _devices,
    "expose": _texts,
    "extra_hosts": _hosts,
    "gpus": _gpus,
    "group_add": _texts,
    "healthcheck": _healthcheck,
    "ipc": _namespace,
    "isolation": _isolation,
    "mem_limit": _sizes,
    "mem_reservation": _sizes,
    "memswap_limit": _sizes,
    "network_mode": _namespace,
    "networks": _networks,
    "pid": _namespace,
    "ports": _ports,
    "security_opt": _security,
    "shm_size": _sizes,
    "stop_grace_period": _duration,
    "volumes": volumes,
    "volumes_from": _volumes_from,
}
"""Of keys whose form is another one here: (work, service, value) -> value."""
