"""Normal forms of declared options: two that make the same container are equal. Used for comparing only; what is sent
and digested stays as it was declared, so that no new version of rorg replaces a container by itself."""

from __future__ import annotations

import signal
from collections.abc import Callable, Mapping
from typing import Any

from rorg.model.options import OPTIONS
from rorg.model.ports import parse_expose, parse_ports
from rorg.model.volumes import parse_device, parse_tmpfs, parse_volume, same_path

Turn = Callable[[Any], Any]
NOTHING = None
"""The normal form of what is as if it had not been declared."""


_NO_MODES = frozenset(("rw", "rprivate", "consistent", "cached", "delegated"))
"""What a volume is by itself, or what means nothing on Linux."""


def _each(turn: Turn) -> Turn:
    """A list in which neither order nor repetition matters."""

    def run(value: Any) -> Any:
        found = {repr(new): new for new in (_tried(turn, item) for item in value)}
        return [found[key] for key in sorted(found)] or NOTHING

    return run


def _tried(turn: Turn, value: Any) -> Any:
    """What was declared for an old container may be what would be refused today."""
    try:
        return turn(value)
    except (ValueError, TypeError, AttributeError, LookupError, OverflowError, RecursionError):
        return value


def _spread(turn: Callable[[str], list[str]]) -> Turn:
    """A list of which each item stands for several."""

    def run(value: Any) -> Any:
        several = (_tried(turn, item) for item in value)
        return sorted({one for many in several for one in (many if isinstance(many, list) else [many])}) or NOTHING

    return run


def _ports(text: str) -> list[str]:
    return [f"{p.address}:{p.host}:{p.port}" for p in parse_ports(text)]


def _paths(value: Any) -> Any:
    """Here an empty list is something else than none: nothing is masked."""
    return sorted(set(value))


def _same(value: Any) -> Any:
    return value


def _among(*defaults: Any) -> Turn:
    return lambda value: NOTHING if value in defaults else value


def _capability(name: str) -> str:
    return name.upper().removeprefix("CAP_")


def _device(text: str) -> str:
    source, target, access = parse_device(text)
    return f"{source}:{target}:{''.join(sorted(access))}"


def _volume(value: Any) -> Any:
    if not isinstance(value, str):
        return {k: v for k, v in value.items() if v not in (False, None, "", {})}
    volume = parse_volume(value)
    source = same_path(volume.source) if volume.source.startswith("/") else volume.source
    modes = ",".join(sorted(set(volume.modes) - _NO_MODES))
    return ":".join(part for part in (source, same_path(volume.target), modes) if part)


def _tmpfs(text: str) -> str:
    target, options = parse_tmpfs(text)
    return same_path(target) + (f":{','.join(sorted(options.split(',')))}" if options else "")


def _security(text: str) -> str:
    """The engine still takes the colon of old."""
    name, colon, value = text.partition(":")
    text = f"{name}={value}" if colon and "=" not in name else text
    return "no-new-privileges" if text == "no-new-privileges=true" else text


def _signal(text: str) -> str:
    try:
        return signal.Signals(int(text)).name
    except ValueError:
        return text


def _restart(text: str) -> Any:
    return NOTHING if text == "no" else text.removesuffix(":0")


def _hosts(value: Any) -> Any:
    """The first address of a name counts, so their order does."""
    return sorted(value, key=lambda item: item.partition(":")[0]) or NOTHING


def _healthcheck(value: Any) -> Any:
    if value.get("disable") or value.get("test") == ["NONE"]:
        return {"disable": True}
    return {k: v for k, v in value.items() if v not in (False, 0, None, [])} or NOTHING


def _networks(value: Any) -> Any:
    return {
        name: {k: sorted(v) if isinstance(v, list) else v for k, v in network.items() if v}
        for name, network in value.items()
    } or NOTHING


def _limit(value: Any) -> Any:
    return NOTHING if value <= 0 else value


_TURNS: Mapping[str, Turn] = {
    "cap_add": _each(_capability),
    "cap_drop": _each(_capability),
    "device_cgroup_rules": _each(_same),
    "devices": _each(_device),
    "expose": _spread(parse_expose),
    "extra_hosts": _hosts,
    "gpus": _each(_same),
    "group_add": _each(_same),
    "healthcheck": _healthcheck,
    "isolation": _among("", "default"),
    "links": _each(_same),
    "masked_paths": _paths,
    "network_mode": _among("", "default", "bridge"),
    "networks": _networks,
    "pids_limit": _limit,
    "ports": _spread(_ports),
    "readonly_paths": _paths,
    "restart": _restart,
    "security_opt": _each(_security),
    "stop_signal": _signal,
    "tmpfs": _each(_tmpfs),
    "volumes": _each(_volume),
}


def normal(option: str, value: Any) -> Any:
    """The normal form of one option's value; None if it means the same as no declaration."""
    if value is None:
        return None
    if option in _TURNS:
        return _tried(_TURNS[option], value)
    return value or NOTHING if option in OPTIONS and OPTIONS[option].empty else value


def normal_fields(fields: Mapping[str, Any]) -> dict[str, Any]:
    """All declared fields of a container in normal form."""
    found = {name: normal(name, value) for name, value in fields.items()}
    return {name: value for name, value in found.items() if value is not NOTHING}
