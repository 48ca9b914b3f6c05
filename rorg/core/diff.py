"""How a container differs from what is declared. Only declared options are compared; defaults filled in by the engine
never count as a difference."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from rorg.core.digest import declared_fields, declared_of, same
from rorg.core.normal import normal, normal_fields
from rorg.core.observed import Container
from rorg.model.catalog import Spec
from rorg.model.options import LIVE


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
    in_place = {"container_name", *(k for k in set_options if k in written)}
    return Difference(tuple(k for k in changed if k not in in_place), live)
