"""How a container differs from what is declared. Only declared options are compared; defaults filled in by the engine
never count as a difference.

Options are compared in normal form: two values that make the same container have the same one. The engine and the
digest get the values as declared, so that an upgrade of rorg with better normal forms replaces no container.
"""

from __future__ import annotations

import json
import signal
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from rorg.core.digest import declared_fields, declared_of, same
from rorg.core.observed import Container
from rorg.model.catalog import Spec
from rorg.model.options import LIVE, OPTIONS
from rorg.model.ports import parse_expose, parse_ports
from rorg.model.volumes import parse_device, parse_tmpfs, parse_volume, same_path

REPLICAS = "replicas"
"""The live value of how many of a container are to run. rorg makes one; only a person can have asked a Swarm for more.
No manifest names it, and it is set back in place."""


@dataclass(frozen=True, slots=True)
class Difference:
    """`recreate`: options that need a new container. `live`: options that can be set in place -> their new values."""

    recreate: tuple[str, ...] = ()
    live: Mapping[str, Any] = field(default_factory=dict)


def declared_now(spec: Spec, secrets: Collection[str] = ()) -> Mapping[str, Any]:
    """Return the declared options in normal form, as a label would store them."""
    return normal_fields(json.loads(json.dumps(declared_fields(spec, secrets))))


@lru_cache(maxsize=1024)
def _declared_then(label: str) -> Mapping[str, Any]:
    """Return the options on a container's label in normal form."""
    return normal_fields(declared_of(label))


def difference(container: Container, spec: Spec, digest: str, now: Mapping[str, Any]) -> Difference:
    """Compare by digest first, and by declared options only if the digests differ. `now` is declared_now(spec)."""
    written: Mapping[str, Any] = {}
    changed: list[str] = []
    if container.digest != digest:
        written, written_normal = declared_of(container.declared), _declared_then(container.declared)
        changed = sorted(k for k in {*written_normal, *now} if not same(written_normal.get(k), now.get(k)))
        if not written:
            # Without a readable record only a new container is sure to be right. With a record, a different digest
            # version does not matter: an upgrade of rorg must not replace containers.
            return Difference(recreate=("digest",))
    # Docker reads 0 as "not set", so an option cannot be removed in place. It must not be newly set in place either, or
    # a rollback would have to remove it. So only a changed value of an option that the container was made with is live.
    set_options = {option for option in LIVE if spec.get(option) not in (None, 0, "")}
    live = {
        option: spec[option]
        for option in set_options - {"container_name"}
        if option in container.live
        and (container.live[option] is not None or option in changed)  # None: this kernel does not support it
        and normal(option, container.live[option]) != normal(option, spec[option])
        and (not changed or option in written)
    }
    if container.live.get(REPLICAS, 1) != 1:
        live[REPLICAS] = 1
    in_place = {"container_name", *(k for k in set_options if k in written)}
    return Difference(tuple(k for k in changed if k not in in_place), live)


def declared_anew(container: Container, options: Collection[str], now: Mapping[str, Any]) -> tuple[str, ...]:
    """Return those of these options that were declared otherwise, or not at all, when the container was made. `now` is
    declared_now(spec)."""
    then = _declared_then(container.declared)
    return tuple(sorted(o for o in options if not same(then.get(o), now.get(o))))


Normalize = Callable[[Any], Any]
NOTHING = None
"""The normal form of a value that has the same effect as declaring nothing."""


_NO_MODES = frozenset(("rw", "rprivate", "consistent", "cached", "delegated"))
"""Volume modes that are Docker's default, or have no effect on Linux."""


def _each(normalize: Normalize) -> Normalize:
    """Normalize a list in which neither order nor repetition matters."""

    def run(value: Any) -> Any:
        by_text = {
            repr(normalized): normalized for normalized in (_normalized_or_same(normalize, item) for item in value)
        }
        return [by_text[key] for key in sorted(by_text)] or NOTHING

    return run


def _normalized_or_same(normalize: Normalize, value: Any) -> Any:
    """Normalize a value, or return it unchanged: an old container may carry values that today's rules refuse."""
    try:
        return normalize(value)
    except (ValueError, TypeError, AttributeError, LookupError, OverflowError, RecursionError):
        return value


def _spread(normalize: Callable[[str], list[str]]) -> Normalize:
    """Normalize a list in which one item can stand for several, such as a range of ports."""

    def run(value: Any) -> Any:
        results = (_normalized_or_same(normalize, item) for item in value)
        return (
            sorted({single for values in results for single in (values if isinstance(values, list) else [values])})
            or NOTHING
        )

    return run


def _ports(text: str) -> list[str]:
    return [f"{p.address}:{p.host}:{p.port}" for p in parse_ports(text)]


def _paths(value: Any) -> Any:
    """Keep an empty list: for masked paths it means "mask nothing", which differs from Docker's default."""
    return sorted(set(value))


def _same(value: Any) -> Any:
    return value


def _among(*defaults: Any) -> Normalize:
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
    """Docker still accepts the old form with a colon."""
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
    """Keep the order of addresses of one name, because the first one counts."""
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


_NORMALIZERS: Mapping[str, Normalize] = {
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
    """Return the normal form of one option; None if it has the same effect as declaring nothing."""
    if value is None:
        return None
    if option in _NORMALIZERS:
        return _normalized_or_same(_NORMALIZERS[option], value)
    return value or NOTHING if option in OPTIONS and OPTIONS[option].empty else value


def normal_fields(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return all declared fields of a container in normal form."""
    normalized = {name: normal(name, value) for name, value in fields.items()}
    return {name: value for name, value in normalized.items() if value is not NOTHING}
