"""What one service's container has of another service's: its network, its shared memory, its processes, its volumes.

The forms are Compose's: `network_mode`, `ipc` and `pid` say `service:NAME`, `volumes_from` says NAME or NAME:ro. What
is declared, and so digested, names the service; the engine is told the id of its container.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

NAMESPACES = ("network_mode", "ipc", "pid")
"""Options of which one alone says whose it is. The run of a service ends with that of the one whose namespace it has;
volumes stay what they are."""
VOLUMES = "volumes_from"
SERVICE = "service:"
CONTAINER = "container:"

Joins = Mapping[str, tuple[str, ...]]
"""Service -> the options by which its container is joined."""


def named(options: Mapping[str, Any]) -> Iterator[tuple[str, int | None, str]]:
    """(option, index in it, name) of all that may name a service. What `volumes_from` names may be a container, too."""
    for option in NAMESPACES:
        value = str(options.get(option) or "")
        if value.startswith(SERVICE):
            yield option, None, value.removeprefix(SERVICE)
    for index, value in enumerate(options.get(VOLUMES) or ()):
        if not value.startswith(CONTAINER):
            yield VOLUMES, index, value.partition(":")[0]


def ends_with(joins: Joins) -> list[str]:
    """The services with whose run a run is over, since it has a namespace of theirs."""
    return [name for name, options in joins.items() if set(options) & set(NAMESPACES)]


def resolved(spec: Mapping[str, Any], joins: Joins, containers: Mapping[str, str]) -> dict[str, Any]:
    """A spec as the engine takes it, with ids of containers (by service) in place of names of services."""
    found = dict(spec)
    for name, options in joins.items():
        for option in options:
            if option == VOLUMES:
                found[option] = _volumes(found[option], name, containers[name])
            else:
                found[option] = CONTAINER + containers[name]
    return found


def _volumes(values: Sequence[str], name: str, container: str) -> list[str]:
    of_it = re.compile(rf"{re.escape(name)}(?=:|$)")
    return [v if v.startswith(CONTAINER) else of_it.sub(container, v, count=1) if of_it.match(v) else v for v in values]
