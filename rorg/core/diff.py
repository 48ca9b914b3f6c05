"""How a container differs from what is declared. Only declared options count; the engine's defaults never do."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from rorg.core.digest import declared_fields, declared_of
from rorg.core.masking import same
from rorg.core.normal import normal, normal_fields
from rorg.core.observed import Container
from rorg.model.catalog import Spec
from rorg.model.options import LIVE


@dataclass(frozen=True, slots=True)
class Difference:
    """`recreate`: options that only a new container can have. `live`: options to set in place, with their values."""

    recreate: tuple[str, ...] = ()
    live: Mapping[str, Any] = field(default_factory=dict)


def declared_now(spec: Spec, secrets: Collection[str] = ()) -> Mapping[str, Any]:
    """What a container made from this spec would have in its record, as it would be read back, in normal form."""
    return normal_fields(json.loads(json.dumps(declared_fields(spec, secrets))))


@lru_cache(maxsize=1024)
def _declared_then(label: str) -> Mapping[str, Any]:
    return normal_fields(declared_of(label))


def difference(container: Container, spec: Spec, digest: str, now: Mapping[str, Any]) -> Difference:
    """Compares by digest first, and by declared options only where the digests differ. `now` is declared_now(spec)."""
    written: Mapping[str, Any] = {}
    changed: list[str] = []
    if container.digest != digest:
        written, was = declared_of(container.declared), _declared_then(container.declared)
        changed = sorted(k for k in {*was, *now} if not same(was.get(k), now.get(k)))
        if not written:
            # Without a readable record of what it was made from, only a new container is sure to be right. With one,
            # the digest's version does not matter: a new rorg must not replace anything by itself.
            return Difference(recreate=("digest",))
    # An engine takes 0 for "not said", so an option cannot be taken back in place, nor, lest a rollback be impossible,
    # newly set: only another value for an option that the container was made with is live.
    said = {option for option in LIVE if spec.get(option) not in (None, 0, "")}
    live = {
        option: spec[option]
        for option in said - {"container_name"}
        if option in container.live
        and (container.live[option] is not None or option in changed)  # None: its kernel cannot do what it was asked
        and normal(option, container.live[option]) != normal(option, spec[option])
        and (not changed or option in written)
    }
    in_place = {"container_name", *(k for k in said if k in written)}
    return Difference(tuple(k for k in changed if k not in in_place), live)
