"""Whether a container has rights that other containers lack, option by option, as manifests render them."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

from rorg.model.catalog import Spec
from rorg.model.run_directory import RUN
from rorg.model.volumes import Volume, parse_volume

FREE = frozenset(
    {
        *("command", "container_name", "domainname", "dns", "dns_opt", "dns_search", "entrypoint", "environment"),
        *("expose", "extra_hosts", "healthcheck", "hostname", "image", "init", "logging", "mem_swappiness"),
        *("platform", "restart", "shm_size", "stdin_open", "stop_grace_period", "stop_signal", "tmpfs", "tty"),
        *("mem_reservation", "working_dir"),
    }
)
"""Options that reach nothing outside the container with any value."""
UNLIMITED = (None, -1, 0)
Within = Callable[[Any, Any], bool]
"""Whether the first value of an option gives no more rights than the second."""


def exceeding(spec: Spec, others: Collection[Spec], grant: Spec, granted: Collection[str]) -> list[str]:
    """The options in which a container has more rights than each of the others. Of `grant`, only the options `granted`
    count."""
    options = {*spec, *(option for other in others for option in other)} - FREE
    return sorted(
        option
        for option in options
        if not any(_within(option, spec, other) for other in others)
        and not (option in granted and _within(option, spec, grant))
    )


def _within(option: str, spec: Spec, other: Spec) -> bool:
    if option in ("network_mode", "networks"):
        return _same_network(spec, other)
    mine, theirs = spec.get(option), other.get(option)
    return bool(mine == theirs) or _RULES.get(option, _unset)(mine, theirs)


def _unset(mine: Any, _: Any) -> bool:
    """For options that only give rights: without it, what the engine does is safe."""
    return mine in (None, False, "", [], {})


def _theirs_unset(_: Any, theirs: Any) -> bool:
    """For options that only take rights away."""
    return _unset(theirs, None)


def _no_higher(mine: Any, theirs: Any) -> bool:
    return bool(_amount(mine) <= _amount(theirs))


def _amount(value: Any) -> float:
    return math.inf if value in UNLIMITED else float(value)


def _no_larger_share(mine: Any, theirs: Any) -> bool:
    return bool((mine or 1024) <= (theirs or 1024))


def _no_safer_from_oom(mine: Any, theirs: Any) -> bool:
    return bool((mine or 0) >= (theirs or 0))


def _no_more_items(mine: Any, theirs: Any) -> bool:
    return _items(mine) <= _items(theirs)


def _no_fewer_items(mine: Any, theirs: Any) -> bool:
    return _items(theirs) <= _items(mine) or "ALL" in (mine or ())


def _items(value: Any) -> set[str]:
    parts = value.items() if isinstance(value, Mapping) else value if isinstance(value, list) else (value,)
    return {json.dumps(part, sort_keys=True) for part in parts if part is not None}


def _user(mine: Any, theirs: Any) -> bool:
    """Without `user` the image decides, so nothing is known."""
    return _root(theirs) or (theirs in (None, "") and mine not in (None, "") and not _root(mine))


def _root(user: Any) -> bool:
    return str(user).partition(":")[0] in ("0", "root")


def _security(mine: Any, theirs: Any) -> bool:
    """`no-new-privileges` only takes rights away; every other security option may do either."""
    (locked, more), (must, known) = _split(mine), _split(theirs)
    return locked >= must and more == known


def _split(options: Any) -> tuple[bool, set[str]]:
    """Whether a container cannot gain privileges; and its other security options."""
    said = [str(option).replace("=", ":") for option in options or ()]
    words = [option for option in said if option.partition(":")[0] == "no-new-privileges"]
    return bool(words) and not words[-1].endswith(":false"), {o for o in said if o not in words}


def _volumes(mine: Any, theirs: Any) -> bool:
    known = list(_mounts(theirs))
    return all(any(_mount_within(one, other) for other in known) for one in _mounts(mine))


def _mounts(volumes: Any) -> Iterator[Volume]:
    """Mounts from outside; a volume without a name is the container's own."""
    for volume in volumes or ():
        if not isinstance(volume, str):
            whole = {k: v for k, v in volume.items() if k not in ("target", "read_only")}
            yield Volume(json.dumps(whole, sort_keys=True), "", ("ro",) if volume.get("read_only") else ())
        elif (mount := parse_volume(volume.replace(RUN, "/run/rorg"))).source:
            yield mount


def _mount_within(mine: Volume, theirs: Volume) -> bool:
    reads = "ro" in mine.modes or "ro" not in theirs.modes
    return mine.source == theirs.source and reads and set(mine.modes) - {"ro", "rw"} <= set(theirs.modes)


def _same_network(spec: Spec, other: Spec) -> bool:
    mine, theirs = network_of(spec), network_of(other)
    if mine == "networks" == theirs:
        return set(spec["networks"]) <= set(other["networks"])
    return mine in ("none", theirs) or (mine == "bridge" and theirs == "host")


def network_of(spec: Spec) -> str:
    """`host`, `bridge`, `none`, `networks` if it names some, or the service or container whose network it shares."""
    if spec.get("networks"):
        return "networks"
    mode = str(spec.get("network_mode") or "bridge")
    return "none" if spec.get("network_disabled") else "bridge" if mode == "default" else mode


_RULES: Mapping[str, Within] = {
    **dict.fromkeys(("cpus", "mem_limit", "memswap_limit", "pids_limit", "cpu_quota"), _no_higher),
    **dict.fromkeys(("blkio_config", "cpuset", "cpuset_mems", "storage_opt"), _theirs_unset),
    **dict.fromkeys(("cgroup_parent", "cpu_period", "runtime"), lambda _mine, _theirs: False),
    **dict.fromkeys(
        ("annotations", "cap_add", "device_cgroup_rules", "devices", "group_add", "labels", "links", "ports")
        + ("sysctls", "ulimits", "volumes_from"),
        _no_more_items,
    ),
    "cap_drop": _no_fewer_items,
    "cpu_shares": _no_larger_share,
    "oom_score_adj": _no_safer_from_oom,
    "read_only": lambda mine, theirs: bool(mine) or not theirs,
    "security_opt": _security,
    "user": _user,
    "volumes": _volumes,
}
"""Option -> its rule if two values differ. Options without a rule only give rights."""
