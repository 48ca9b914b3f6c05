"""Which networks and volumes of the engine a container uses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rorg.model.catalog import Spec
from rorg.model.objects import subject
from rorg.model.volumes import is_path


def keys_of(spec: Spec) -> Iterator[str]:
    """All networks and named volumes that a container of this spec uses, declared or not."""
    for name in spec.get("networks") or ():
        yield subject("network", name)
    if spec.get("network_mode"):
        yield subject("network", str(spec["network_mode"]))
    for volume in spec.get("volumes") or ():
        if name := _named(volume):
            yield subject("volume", name)


def _named(volume: Any) -> str:
    """The name of a volume; empty for a path of the host, and for one without a name."""
    if isinstance(volume, Mapping):
        return str(volume.get("source") or "") if volume.get("type") == "volume" else ""
    source, colon, _ = volume.partition(":")
    return source if colon and not is_path(source) else ""
