"""The difference between two states of the manifests, field by field, without a robot or an engine: `rorg diff
REVISION`."""

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
"""Fields that make no difference on a robot, or that are compared in another form."""

CONTENT = "content"
"""Pseudo-field: mounted path of the tree -> digest of its content."""
PARAMETERS = "ros.parameters"
"""Pseudo-field: name of a ROS parameter -> its value, which may be secret and is therefore masked."""


@dataclass(frozen=True, slots=True)
class Changed:
    """A resource that differs: a service, group, image, network, volume, request or the Policy. `verb` is add, change
    or remove."""

    kind: str
    name: str
    verb: str
    changes: tuple[Change, ...] = ()

    def as_json(self) -> dict[str, Any]:
        return {"kind": self.kind, "name": self.name, "verb": self.verb, "changes": [c.as_json() for c in self.changes]}


def manifest_changes(old: Desired, new: Desired) -> tuple[Changed, ...]:
    """Return all changes, services first, each kind sorted by name."""
    return tuple(_compared(_resources(old), _resources(new)))


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


def _resources(desired: Desired) -> dict[str, dict[str, dict[str, Any]]]:
    """Return kind -> name -> fields, as plain JSON."""
    catalog = desired.catalog
    services = {n: s for n, s in catalog.services.items() if n != DEVELOPER}
    return {
        "Service": {name: _service(desired, name) for name in services},
        "Group": {name: _fields(group) for name, group in catalog.groups.items()},
        "Image": {name: _fields(image) for name, image in catalog.images.items()},
        "Network": {name: _network_or_volume(network) for name, network in catalog.networks.items()},
        "Volume": {name: _network_or_volume(volume) for name, volume in catalog.volumes.items()},
        "Request": {request.id: _fields(request) for request in catalog.requests},
        "Policy": {"": _fields(catalog.policy)},
    }


def _service(desired: Desired, name: str) -> dict[str, Any]:
    """Return the fields of a service, including container options and the content it mounts from the tree."""
    service = desired.catalog.services[name]
    extra = {CONTENT: dict(desired.contents.get(name, {})), PARAMETERS: dict(service.ros.values) if service.ros else {}}
    return {**_fields(service), **_plain(declared_fields(service.spec or {}, service.secrets)), **extra}


def _network_or_volume(declared: EngineObject) -> dict[str, Any]:
    """Return the fields of a network or volume."""
    return {"name": declared.called, "external": declared.external, **declared_options(declared)}


def _fields(resource: Any) -> dict[str, Any]:
    plain: dict[str, Any] = _plain({k: v for k, v in asdict(resource).items() if k not in UNTOLD})
    return plain


def _plain(value: Any) -> Any:
    return json.loads(json.dumps(value))
