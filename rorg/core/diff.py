"""How a container differs from what is declared. Only declared options count; the engine's defaults never do."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from rorg.core.digest import VERSION, declared_fields
from rorg.core.observed import Container
from rorg.manifest.catalog import Spec
from rorg.manifest.container import LIVE

RESET: Mapping[str, Any] = {"cpuset": "", "cpuset_mems": "", "restart": "no"}
"""Value of a live option that is no longer declared; 0 for all others (Docker: no limit, default weight)."""


@dataclass(frozen=True, slots=True)
class Difference:
    """`recreate`: options that only a new container can have. `live`: options to set in place, with their values."""

    recreate: tuple[str, ...] = ()
    live: Mapping[str, Any] = field(default_factory=dict)


def difference(container: Container, spec: Spec, digest: str) -> Difference:
    """Compares by digest first, and by declared options only where the digests differ."""
    was: Mapping[str, Any] = {}
    changed: list[str] = []
    if container.digest != digest:
        was = _parse(container.declared)
        now = json.loads(json.dumps(declared_fields(spec)))
        changed = sorted(k for k in {*was, *now} if was.get(k) != now.get(k))
        if not was or not container.digest.startswith(VERSION + ":"):
            # Without a readable record of what it was made from, only a new container is sure to be right.
            return Difference(recreate=("digest",))
    live = {}
    for option in LIVE - {"container_name"}:
        if option in spec or option in was:
            value = spec.get(option, RESET.get(option, 0))
            if option in container.live and container.live[option] != value:
                live[option] = value
    return Difference(tuple(k for k in changed if k not in LIVE), live)


def _parse(text: str) -> Mapping[str, Any]:
    try:
        value = json.loads(text)
    except ValueError:
        return {}
    return value if isinstance(value, dict) else {}
