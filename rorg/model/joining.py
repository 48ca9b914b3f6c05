"""Joined containers: one service's container uses another's network, shared memory, processes or volumes.

The forms are Compose's: `network_mode`, `ipc` and `pid` contain `service:NAME`; `volumes_from` contains NAME or
NAME:ro. The declared and digested spec has the service's name; the engine gets the id of its container.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

NAMESPACES = ("network_mode", "ipc", "pid")
"""Options that name one namespace. A run ends with the run of the service whose namespace it uses; volumes outlive a
run."""
VOLUMES = "volumes_from"
SERVICE = "service:"
CONTAINER = "container:"

Joins = Mapping[str, tuple[str, ...]]
"""Service -> the options by which its container is joined."""


def named(options: Mapping[str, Any]) -> Iterator[tuple[str, int | None, str]]:
    """(option, index in it, name) of everything that may be a service. Names in `volumes_from` may also be
    containers."""
    for option in NAMESPACES:
        value = str(options.get(option) or "")
        if value.startswith(SERVICE):
            yield option, None, value.removeprefix(SERVICE)
    for index, value in enumerate(options.get(VOLUMES) or ()):
        if not value.startswith(CONTAINER):
            yield VOLUMES, index, value.partition(":")[0]


def ends_with(joins: Joins) -> list[str]:
    """Services whose end also ends this service's run, because it uses a namespace of theirs."""
    return [name for name, options in joins.items() if set(options) & set(NAMESPACES)]


def resolved(spec: Mapping[str, Any], joins: Joins, containers: Mapping[str, str]) -> dict[str, Any]:
    """The spec for the engine, with ids of containers (by service) instead of names of services."""
    engine_spec = dict(spec)
    for name, options in joins.items():
        for option in options:
            if option == VOLUMES:
                engine_spec[option] = _volumes(engine_spec[option], name, containers[name])
            else:
                engine_spec[option] = CONTAINER + containers[name]
    return engine_spec


def _volumes(values: Sequence[str], name: str, container: str) -> list[str]:
    of_it = re.compile(rf"{re.escape(name)}(?=:|$)")
    return [v if v.startswith(CONTAINER) else of_it.sub(container, v, count=1) if of_it.match(v) else v for v in values]
