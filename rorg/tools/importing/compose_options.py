"""The options of a Compose service as the `container` section of a manifest. Options with the same name and form are
copied; all others have a function here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rorg.model.options import OPTIONS
from rorg.model.units import format_duration
from rorg.tools.compose.shorts import CDI
from rorg.tools.importing.compose_keys import HEALTHCHECK, SERVICE, SERVICE_NETWORK
from rorg.tools.importing.compose_mounts import volumes
from rorg.tools.importing.compose_work import Work, nonempty, size

Form = Callable[[Work, str, Any], Any]
"""Converts a value; gets the service's name for messages."""
ELSEWHERE = frozenset(("env_file", "environment", "labels", "container_name"))
"""Handled separately, because several keys contribute to them."""

OF_THE_ENGINE = frozenset(("host", "none", "bridge"))
"""Networks that always exist; a container joins them with network_mode."""
BUILT_IN = tuple(
    f"/dev/{name}"
    for name in (
        *("dma_heap", "dri", "fuse", "gpiochip", "gpiomem", "i2c", "kfd", "kvm", "mem", "net", "null", "nv", "shm"),
        *("spidev", "tegra", "vchiq", "vcio", "zero", "host1x"),
    )
)
"""Devices that are part of the machine or of the kernel."""
WITHOUT = {"host": ("ports", "mac_address"), "none": ("ports",), "service": ("ports", "expose")}
"""Options that the engine ignores, by kind of network."""


def options(work: Work, name: str) -> dict[str, Any]:
    """All options of a service that are carried over, in the order of the table."""
    said = work.project.services[name]
    container_options: dict[str, Any] = {}
    for key, row in SERVICE.items():
        given = _gpu_requests(said) if key == "gpus" else said.get(key)
        if row.how == "carried" and key not in ELSEWHERE and given is not None:
            value = FORMS[key](work, name, given) if key in FORMS else given
            if value not in ({}, [], None) or key == "entrypoint":
                container_options[key] = value
    return _on_its_network(work, name, container_options)


def _on_its_network(work: Work, name: str, container_options: dict[str, Any]) -> dict[str, Any]:
    """Without options that have no effect on a network that is not the container's own."""
    own = {work.known("networks", n) for n in work.project.services[name].get("networks") or ()} & OF_THE_ENGINE
    if own:
        del container_options["networks"]
        container_options["network_mode"] = min(own)
    mode = container_options.get("network_mode", "")
    without = WITHOUT.get("service" if mode.startswith(("service:", "container:")) else mode, ())
    for key in without:
        if key in container_options:
            work.note(f"{key} has no effect under network_mode: {mode}", "services", name, key)
    return {key: value for key, value in container_options.items() if key not in without}


def _rates(value: Mapping[str, Any]) -> Any:
    lists = {key: items for key, items in value.items() if isinstance(items, list)}
    rates = {key: [{k: size(v) if k == "rate" else v for k, v in one.items()} for one in lists[key]] for key in lists}
    return {**value, **rates}


def _devices(work: Work, name: str, value: list[Mapping[str, str]]) -> Any:
    devices = []
    nodes = [item for item in value if not CDI.fullmatch(item["source"])]
    if unpluggable := [item for item in nodes if not item["source"].startswith(BUILT_IN)]:
        names = ", ".join(item["source"] for item in unpluggable)
        message = f"rorg waits for {names} to be plugged in only if `driver` names it"
        work.note(
            message,
            "services",
            name,
            "devices",
            remedy=f"driver: {{devices: [{', '.join(map(_entry, nodes))}]}} instead of container.devices",
        )
    for item in nodes:
        source, target, access = item["source"], item["target"], item["permissions"]
        short = source if target == source else f"{source}:{target}"
        devices.append(short if access == "rwm" else f"{source}:{target}:{access}")
    return devices


def _hosts(value: list[str]) -> Any:
    return [line.replace("=", ":", 1) for line in value]


def _entry(item: Mapping[str, str]) -> str:
    """A device as `driver` names it."""
    source, target = item["source"], item["target"]
    return source if target == source else f"{{path: {source}, target: {target}}}"


def _gpu_requests(said: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The requests for GPUs of a service, each once: of `gpus`, of its deployment, and of devices with CDI names."""
    reserved = ((said.get("deploy") or {}).get("resources") or {}).get("reservations") or {}
    named = [item["source"] for item in said.get("devices") or () if CDI.fullmatch(item["source"])]
    requests = [*(said.get("gpus") or ()), *(reserved.get("devices") or ())]
    requests += [{"driver": "cdi", "device_ids": named}] * bool(named)
    return [item for index, item in enumerate(requests) if item not in requests[:index]]


def _gpus(value: list[Mapping[str, Any]]) -> Any:
    return [{k: "all" if k == "count" and v == -1 else v for k, v in item.items()} for item in value]


def _logging(work: Work, name: str, value: Mapping[str, Any]) -> Any:
    kept = nonempty(value.get("options") or {})
    for option in (value.get("options") or {}).keys() - kept.keys():
        work.note(f"logging.options.{option} has no value, so it is left out", "services", name, "logging")
    return nonempty({**value, "options": kept})


def _ulimits(work: Work, name: str, value: Mapping[str, Any]) -> Any:
    """Limits of the kernel. The engine reads every negative number as no limit."""
    ulimits = {}
    for limit, said in value.items():
        both = said if isinstance(said, Mapping) else {"soft": said, "hard": said}
        least = {key: max(number, -1) for key, number in both.items()}
        if least != both:
            work.note(
                f"ulimits.{limit}: the engine takes {min(both.values())} for no limit", "services", name, "ulimits"
            )
        ulimits[limit] = least if isinstance(said, Mapping) else least["soft"]
    return ulimits


def _user(_work: Work, _name: str, value: str) -> Any:
    """USER, USER:GROUP. Either side may be empty, if a variable is not set: the engine then takes root's."""
    user, colon, group = value.partition(":")
    return f"{user or 0}:{group}" if colon and group else user or None


def _healthcheck(work: Work, name: str, value: Mapping[str, Any]) -> Any:
    work.check(HEALTHCHECK, value, "services", name, "healthcheck", shown="healthcheck.")
    carried = {k: v for k, v in value.items() if k in HEALTHCHECK and HEALTHCHECK[k].how == "carried"}
    if carried.get("disable"):
        return {"disable": True}
    times = ("interval", "timeout", "start_period")
    return {k: format_duration(v) if k in times else v for k, v in carried.items() if v is not None}


def _ports(value: list[Mapping[str, Any]]) -> Any:
    return [_port(item) for item in value]


def _port(item: Mapping[str, Any]) -> str:
    address = item.get("host_ip") or ""
    address = f"[{address}]" if ":" in address else address
    published, protocol = str(item.get("published") or ""), item.get("protocol") or "tcp"
    inside = f"{item['target']}" + (f"/{protocol}" if protocol != "tcp" else "")
    if address:
        return f"{address}:{published}:{inside}"
    return f"{published}:{inside}" if published else inside


def _networks(work: Work, name: str, value: Mapping[str, Any]) -> Any:
    """Every network has the service's name as an alias, because that is how services find each other under Compose."""
    networks = {}
    for network, said in value.items():
        work.check(SERVICE_NETWORK, said or {}, "services", name, "networks", network, shown=f"networks.{network}.")
        own = {k: v for k, v in (said or {}).items() if k in SERVICE_NETWORK and SERVICE_NETWORK[k].how == "carried"}
        names = dict.fromkeys([name, *(own.pop("aliases", None) or ()), *work.aliases.get(name, ())])
        networks[work.called("networks", network)] = {"aliases": list(names), **nonempty(own)}
    return networks


def _namespace(work: Work, _name: str, value: str) -> Any:
    """`service:NAME` means one container, even if NAME has several copies."""
    kind, colon, other = value.partition(":")
    return f"service:{work.first(other)}" if kind == "service" and colon else value


def _volumes_from(work: Work, _name: str, value: list[str]) -> Any:
    references = []
    for item in value:
        other, colon, access = item.partition(":")
        references.append(item if other == "container" else f"{work.first(other)}{colon}{access}")
    return references


def _security(work: Work, _name: str, value: list[str]) -> Any:
    security_options = []
    for item in value:
        kind, _, profile = item.partition("=") if "=" in item else item.partition(":")
        if kind == "seccomp" and profile not in ("unconfined", "builtin", "") and not profile.startswith("{"):
            item = f"seccomp={work.local(str(work.project.directory / profile))}"
        security_options.append(item)
    return security_options


def _isolation(work: Work, name: str, value: str) -> Any:
    if value != "default":
        message = f"isolation: {value} cannot be carried over: it is for Windows"
        work.refuse(message, "services", name, "isolation", remedy="to drop it")
        return None
    return value


def _plain(form: Callable[[Any], Any]) -> Form:
    """A form that depends only on the value."""
    return lambda _work, _name, value: form(value)


BY_FORM: Mapping[str, Callable[[Any], Any]] = {"size": size, "duration": format_duration}
"""The form of an option in the table of options -> its conversion."""
FORMS: Mapping[str, Form] = {
    **{name: _plain(BY_FORM[option.compose]) for name, option in OPTIONS.items() if option.compose in BY_FORM},
    "blkio_config": _plain(_rates),
    "devices": _devices,
    "extra_hosts": _plain(_hosts),
    "gpus": _plain(_gpus),
    "healthcheck": _healthcheck,
    "isolation": _isolation,
    "logging": _logging,
    "networks": _networks,
    "ports": _plain(_ports),
    "security_opt": _security,
    "ulimits": _ulimits,
    "user": _user,
    "volumes": volumes,
    "volumes_from": _volumes_from,
    **dict.fromkeys(("ipc", "network_mode", "pid"), _namespace),
}
"""Keys whose value has a different form in rorg."""
