"""What has changed between two states of the manifests, thing by thing, without a robot."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from rorg.core.changed_fields import Change, field_changes
from rorg.core.desired import Desired
from rorg.core.digest import declared_fields
from rorg.core.masking import MASK
from rorg.core.objects import declared_options
from rorg.model.catalog import DEVELOPER
from rorg.model.objects import EngineObject

UNTOLD = frozenset(("ros", "where", "origins", "defaults", "spec", "name", "description", "labels", "joins"))
"""What makes nothing different for a robot, or is told otherwise."""

CONTENT = "content"
"""Path of the tree that a service mounts -> digest of what is there."""
PARAMETERS = "ros.parameters"
"""Name of a ROS parameter -> its value, which may be secret."""


@dataclass(frozen=True, slots=True)
class Changed:
    """A service, group, image, network, volume, request or the Policy that is not the same in both. `verb`: add, change
    or remove."""

    kind: str
    name: str
    verb: str
    changes: tuple[Change, ...] = ()

    def as_json(self) -> dict[str, Any]:
        return {"kind": self.kind, "name": self.name, "verb": self.verb, "changes": [c.as_json() for c in self.changes]}


def between(old: Desired, new: Desired) -> tuple[Changed, ...]:
    """Services first, each kind in the order of names."""
    return tuple(_compared(_things(old), _things(new)))


def _compared(old: Mapping[str, Mapping[str, Any]], new: Mapping[str, Mapping[str, Any]]) -> Iterator[Changed]:
    for kind in new:
        was, now = old[kind], new[kind]
        for name in sorted({*was, *now}):
            if name not in was or name not in now:
                yield Changed(kind, name, "add" if name in now else "remove")
                continue
            fields = sorted(f for f in {*was[name], *now[name]} if was[name].get(f) != now[name].get(f))
            if fields:
                changes = [c for f in fields for c in _changes(f, was[name].get(f), now[name].get(f))]
                yield Changed(kind, name, "change", tuple(changes))


def _changes(field: str, old: Any, new: Any) -> list[Change]:
    if field not in (CONTENT, PARAMETERS):
        return field_changes(field, old, new)
    was, now, before = old or {}, new or {}, "" if field == CONTENT else f"{field}."
    names = sorted(n for n in {*was, *now} if was.get(n) != now.get(n))
    return [Change(f"{before}{n}", MASK if n in was else None, MASK if n in now else None) for n in names]


def _things(desired: Desired) -> dict[str, dict[str, dict[str, Any]]]:
    """Kind -> name -> its fields, as plain JSON."""
    catalog = desired.catalog
    services = {n: s for n, s in catalog.services.items() if n != DEVELOPER}
    return {
        "Service": {name: _service(desired, name) for name in services},
        "Group": {name: _fields(group) for name, group in catalog.groups.items()},
        "Image": {name: _fields(image) for name, image in catalog.images.items()},
        "Network": {name: _object(one) for name, one in catalog.networks.items()},
        "Volume": {name: _object(one) for name, one in catalog.volumes.items()},
        "Request": {request.id: _fields(request) for request in catalog.requests},
        "Policy": {"": _fields(catalog.policy)},
    }


def _service(desired: Desired, name: str) -> dict[str, Any]:
    """With the options of its container, and the contents of what it mounts from the tree."""
    service = desired.catalog.services[name]
    found = {CONTENT: dict(desired.contents.get(name, {})), PARAMETERS: dict(service.ros.values) if service.ros else {}}
    return {**_fields(service), **_plain(declared_fields(service.spec or {}, service.secrets)), **found}


def _object(one: EngineObject) -> dict[str, Any]:
    """A network or volume, with its options."""
    return {"name": one.called, "external": one.external, **declared_options(one)}


def _fields(thing: Any) -> dict[str, Any]:
    found: dict[str, Any] = _plain({k: v for k, v in asdict(thing).items() if k not in UNTOLD})
    return found


def _plain(value: Any) -> Any:
    return json.loads(json.dumps(value))
