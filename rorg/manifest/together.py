"""Options of one rendered container that the engine does not accept together."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

from rorg.model.volumes import mounted_at, parse_tmpfs, same_path


class Clash(NamedTuple):
    """Two options that do not go together: the path of the wrong one, a message, a remedy, the option that it clashes
    with (which may come from a profile), the code of the finding if it has one, and whether an option is missing."""

    path: tuple[str | int, ...]
    message: str
    remedy: str = ""
    other: str = ""
    code: str = ""
    lacks: bool = False


Options = Mapping[str, Any]
Rule = Callable[[Options], Iterator[Clash]]


def clashes(options: Options) -> list[Clash]:
    """Returns all clashes within one container."""
    return [clash for rule in RULES for clash in rule(options)]


_OF_NETWORKS = ("ports", "expose", "publish_all_ports", "hostname", "links", "dns", "extra_hosts", "mac_address")


def _network(options: Options) -> Iterator[Clash]:
    mode = options.get("network_mode", "")
    if mode and options.get("networks"):
        message = f"networks and network_mode: {mode} exclude each other"
        yield Clash(("networks",), message, "to drop one of them", "network_mode")
    if mode.startswith(("container:", "service:")):
        for option in (o for o in _OF_NETWORKS if options.get(o)):
            message = f"{option} is not for a container that uses another container's network"
            yield Clash((option,), message, "to declare it there", "network_mode")
    elif mode in ("host", "none"):
        useless = ("ports", "publish_all_ports", *(("links", "mac_address") if mode == "host" else ()))
        for option in (o for o in useless if options.get(o)):
            code = "ports-with-host-network" if mode == "host" and option in ("ports", "publish_all_ports") else ""
            message, remedy = (
                f"{option} has no effect under network_mode: {mode}",
                "network_mode: bridge, or drop it",
            )
            yield Clash((option,), message, remedy, "network_mode", code)


def _namespaces(options: Options) -> Iterator[Clash]:
    if options.get("uts") == "host" and options.get("hostname"):
        yield Clash(("hostname",), "under uts: host the host's name is used", "to drop one of them", "uts")
    for name in options.get("sysctls", {}):
        foreign = {
            "network_mode": name.startswith("net."),
            "ipc": name.startswith(("kernel.", "fs.mqueue.")) and name != "kernel.domainname",
            "uts": name == "kernel.domainname",
        }
        for option, theirs in foreign.items():
            if theirs and options.get(option) == "host":
                message = f"'{name}' belongs to the host under {option}: host"
                code = "sysctls-with-host-network" if option == "network_mode" else ""
                yield Clash(("sysctls", name), message, f"to set it on the host, or use another {option}", option, code)


def _limits(options: Options) -> Iterator[Clash]:
    memory, swap = options.get("mem_limit", 0), options.get("memswap_limit", 0)
    for option in ("cpu_period", "cpu_quota"):
        if options.get("cpus") and options.get(option, 0) > 0:
            yield Clash((option,), f"cpus and {option} exclude each other", "to drop one of them")
    if swap > 0 and not memory:
        yield Clash(("memswap_limit",), "memswap_limit needs mem_limit", "to declare mem_limit too", lacks=True)
    elif 0 < swap < memory:
        yield Clash(("memswap_limit",), "memswap_limit, which is memory and swap together, is below mem_limit")
    if memory and options.get("mem_reservation", 0) > memory:
        yield Clash(("mem_reservation",), "mem_reservation is above mem_limit")
    if options.get("cpu_rt_runtime", 0) > (options.get("cpu_rt_period") or 1_000_000):
        yield Clash(("cpu_rt_runtime",), "cpu_rt_runtime is above cpu_rt_period")


def _places(options: Options) -> Iterator[Clash]:
    """Two mounts at one path. A volume without a name gives way to the other one, so it is not reported."""
    taken = {same_path(parse_tmpfs(value)[0]) for value in options.get("tmpfs", ())}
    for index, value in enumerate(options.get("volumes", ())):
        place = mounted_at(value)
        if isinstance(value, str) and ":" not in value:
            continue
        if place in taken:
            yield Clash(("volumes", index), f"something else is mounted at {place} already", "another place")
        taken.add(place)


_COMMON = ("labels", "labels-regex", "env", "env-regex", "tag")
_FILES = ("max-size", "max-file", "compress")
_SYSLOG = ("address", "facility", "tls-ca-cert", "tls-cert", "tls-key", "tls-skip-verify", "format")
_DRIVERS: Mapping[str, tuple[str, ...] | None] = {
    "json-file": (*_FILES, *_COMMON),
    "local": _FILES,
    "journald": _COMMON,
    **dict.fromkeys(("none", "gelf", "fluentd", "awslogs", "splunk", "gcplogs", "etwlogs", "logentries")),
    "syslog": (*_COMMON, *(f"syslog-{name}" for name in _SYSLOG)),
}
"""Logging drivers and their options; None if a driver accepts any. Unlisted drivers are plugins."""
_BUFFER = ("mode", "max-buffer-size")
_SIZE = r"[0-9]+(\.[0-9]+)? ?[kKmMgGtTpP]?[iI]?[bB]?"
_LOG_VALUES = {
    "max-size": _SIZE,
    "max-buffer-size": _SIZE,
    "max-file": "[1-9][0-9]{0,5}",
    "mode": "blocking|non-blocking",
    "compress": "1|t|T|TRUE|true|True|0|f|F|FALSE|false|False",
}


def _logging(options: Options) -> Iterator[Clash]:
    logging = options.get("logging", {})
    driver, values = logging.get("driver", "json-file"), logging.get("options", {})
    if driver not in _DRIVERS and (near := difflib.get_close_matches(driver, _DRIVERS, 1, 0.75)):
        yield Clash(("logging", "driver"), f"'{driver}' is not a logging driver", f"'{near[0]}'")
    known = _DRIVERS.get(driver)
    if known is None:
        return
    for key, value in values.items():
        if key not in (*known, *_BUFFER):
            message = f"the driver {driver} has no option '{key}'"
            yield Clash(("logging", "options", key), message, f"one of {', '.join(known)}")
        elif key in _LOG_VALUES and not re.fullmatch(_LOG_VALUES[key], value):
            yield Clash(("logging", "options", key), f"'{value}' is not a value of {key}")
    if values.get("max-buffer-size") and values.get("mode") != "non-blocking":
        yield Clash(("logging", "options", "max-buffer-size"), "max-buffer-size needs mode: non-blocking", lacks=True)


def _security(options: Options) -> Iterator[Clash]:
    for option in ("masked_paths", "readonly_paths"):
        if options.get(option) and "systempaths=unconfined" in options.get("security_opt", ()):
            yield Clash((option,), f"{option} and systempaths=unconfined exclude each other", "to drop one of them")


RULES: tuple[Rule, ...] = (_network, _namespaces, _limits, _places, _logging, _security)
