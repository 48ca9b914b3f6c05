"""Changed fields with old and new values, for people to read: of a container that differs from its manifest, and of two
states of the manifests, without a robot or an engine (`rorg diff REVISION`)."""

from __future__ import annotations

import json
import shlex
from collections.abc import Collection, Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import takewhile
from typing import Any, Protocol

from rorg.core.desired import Desired
from rorg.core.diff import Difference, normal, normal_fields
from rorg.core.digest import declared_fields, declared_of
from rorg.core.masking import MASK, masked
from rorg.core.objects import declared_options
from rorg.core.observed import Container
from rorg.model.catalog import DEVELOPER, Spec
from rorg.model.objects import EngineObject
from rorg.model.options import LIVE
from rorg.model.probe import Probe
from rorg.model.units import format_duration, format_memory

LONG = 60
"""Characters; longer values are shortened to the part that differs."""
CONTEXT = 16
"""Characters shown before the first difference in a shortened value."""
ORDERED = ("command", "entrypoint")
"""Lists that are one value, such as a command line, rather than a set of entries."""
NO_TEXTS = frozenset(("true", "false", "yes", "no", "on", "off", "null", "y", "n"))
"""Words that YAML does not read as texts, in any case."""
BYTES = ("mem_limit", "mem_reservation", "memswap_limit", "shm_size")


@dataclass(frozen=True, slots=True)
class Change:
    """One changed field. Values are masked already; None means not set."""

    field: str
    old: Any
    new: Any

    def __str__(self) -> str:
        """Return the change as one line."""
        if self.old == self.new:
            return f"{self.field} changed"
        if MASK in (self.old, self.new):
            return f"{self.field} {'added' if self.old is None else 'removed' if self.new is None else 'changed'}"
        if all(isinstance(v, list | None) for v in (self.old, self.new)) and self.field not in ORDERED:
            old, new = self.old or [], self.new or []
            entries = [f"+ {_shown(v)}" for v in new if v not in old] + [f"- {_shown(v)}" for v in old if v not in new]
            return f"{self.field}: {', '.join(entries)}" if entries else f"{self.field}: order changed"
        if self.field in BYTES:
            return f"{self.field}: {_bytes(self.old)} -> {_bytes(self.new)}"
        old, new = _cut_to_difference(_shown(self.old), _shown(self.new))
        return f"{self.field}: {old} -> {new}"

    def as_json(self) -> dict[str, Any]:
        return {"field": self.field, "old": self.old, "new": self.new, "text": str(self)}


def changed_fields(
    container: Container, spec: Spec, difference: Difference, secrets: Collection[str] = ()
) -> tuple[Change, ...]:
    """Return what differs between a container and its spec. `difference` was computed from the same two; `secrets`
    names secret variables of the spec."""
    was, now = declared_of(container.declared), _declared(spec, secrets)
    changes = [c for k in difference.recreate for c in field_changes(k, was.get(k), now.get(k))]
    changes += [Change(k, container.live.get(k), v) for k, v in sorted(difference.live.items())]
    return tuple(changes)


def changes_between(was: Mapping[str, Any], now: Mapping[str, Any]) -> tuple[Change, ...]:
    """Return the changes between two records of what a container was made from."""
    old_fields, new_fields = normal_fields(was), normal_fields(now)
    names = sorted(k for k in {*old_fields, *new_fields} if old_fields.get(k) != new_fields.get(k))
    return tuple(c for k in names for c in field_changes(k, was.get(k), now.get(k)))


def unified(name: str, container: Container | None, spec: Spec | None, secrets: Collection[str] = ()) -> str:
    """Return a unified diff from what a container was made from to what is declared, with secrets masked; "" if nothing
    differs. A container or spec of None stands for an empty side."""
    from difflib import unified_diff

    old_fields, new_fields = (
        {} if container is None else _as_it_is(container),
        {} if spec is None else dict(_declared(spec, secrets)),
    )
    old_fields = {
        k: new_fields[k] if k in new_fields and normal(k, v) == normal(k, new_fields[k]) else v
        for k, v in old_fields.items()
    }
    before = f"{name} ({f'container {container.id[:12]}' if container else 'no container'})"
    after = f"{name} ({'no manifest' if spec is None else 'manifests'})"
    lines = unified_diff(
        _lines(old_fields, new_fields, "before"), _lines(new_fields, old_fields, "after"), before, after, lineterm=""
    )
    return "".join(f"{line.rstrip()}\n" for line in lines)


def _declared(spec: Spec, secrets: Collection[str]) -> Mapping[str, Any]:
    """Return declared fields as they would be read back from a container's label."""
    fields: Mapping[str, Any] = _plain(declared_fields(spec, secrets))
    return fields


def _as_it_is(container: Container) -> dict[str, Any]:
    """Return what the container was made from, updated with live options that were set since."""
    was = dict(declared_of(container.declared))
    live = {k: v for k, v in container.live.items() if k in LIVE and k in was and v is not None}
    return {**was, **live}


def field_changes(field: str, old: Any, new: Any) -> list[Change]:
    """Return the changes of one field, one per differing key if the values are mappings."""
    if all(isinstance(value, dict | None) for value in (old, new)) and (old or new):
        before, after = old or {}, new or {}
        keys = sorted(k for k in {*before, *after} if before.get(k) != after.get(k))
        return [c for k in keys for c in field_changes(f"{field}.{k}", before.get(k), after.get(k))]
    return [Change(field, masked(field, old), masked(field, new))]


class Probed(Protocol):
    """Something with the probes of a service."""

    @property
    def ready(self) -> Probe | None: ...
    @property
    def live(self) -> Probe | None: ...


def probe_changes(was: Probed, now: Probed) -> tuple[Change, ...]:
    """Return what differs between the probes of a service then and now, in the words of manifests."""
    pairs = ("ready", was.ready, now.ready), ("live", was.live, now.live)
    return tuple(
        change
        for role, old, new in pairs
        if old != new
        for change in field_changes(role, _probe_fields(old, bool(new)), _probe_fields(new, bool(old)))
    )


def _probe_fields(probe: Probe | None, whole: bool = True) -> dict[str, Any] | None:
    """Return a probe as in a manifest; without `whole`, only its question."""
    if probe is None:
        return None
    question = {probe.kind: [_question(part) for part in probe.parts]} if probe.parts else _question(probe)
    often = {} if probe.parts else {"interval": format_duration(probe.interval)}
    more = {"timeout": format_duration(probe.timeout), **often, "failures": probe.failures}
    return {**question, **(more if whole else {})}


def _question(probe: Probe) -> dict[str, Any]:
    """Return what a probe asks, with a target of several words as one text."""
    target = shlex.join(probe.target) if isinstance(probe.target, tuple) else probe.target
    return {probe.kind: str(target).removeprefix("127.0.0.1:") if probe.kind == "tcp" else target}


def _shown(value: Any) -> str:
    if value is None:
        return "(unset)"
    if isinstance(value, list) and all(isinstance(v, str) for v in value):
        return shlex.join(value)
    return value if isinstance(value, str) and value else json.dumps(value, ensure_ascii=False)


def _bytes(value: Any) -> str:
    return format_memory(value) if isinstance(value, int) else _shown(value)


def _cut_to_difference(old: str, new: str) -> tuple[str, str]:
    """Return both values, shortened around the first difference if they are long."""
    same = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(old, new, strict=False)))
    begin = 0 if max(len(old), len(new)) <= LONG else max(0, same - CONTEXT)
    return _part(old, begin), _part(new, begin)


def _part(text: str, begin: int) -> str:
    return "..." * bool(begin) + text[begin : begin + LONG] + "..." * (len(text) > begin + LONG)


def _lines(fields: Mapping[str, Any], other: Mapping[str, Any], word: str) -> list[str]:
    """Render fields as YAML. If two values differ only in masked parts, a comment with `word` marks the line, because
    both would look the same."""
    lines = []
    for name, value in sorted(fields.items()):
        shown = masked(name, value)
        hidden = name in other and value != other[name] and shown == masked(name, other[name])
        lines += [*_yaml(name, shown), *([f"  # {word}"] if hidden else [])]
    return lines


def _yaml(name: str, value: Any) -> list[str]:
    if value and isinstance(value, list):
        return [f"{name}:", *(f"  - {_scalar(item)}" for item in value)]
    if value and isinstance(value, dict):
        return [f"{name}:", *(f"  {key}: {_scalar(item)}" for key, item in sorted(value.items()))]
    return [f"{name}: {_scalar(value)}"]


def _scalar(value: Any) -> str:
    """Return a scalar as YAML. JSON is valid YAML; quotes are left out if the text reads the same without them."""
    plain = isinstance(value, str) and value.replace("/", "").replace("_", "").replace("-", "").isalnum()
    reads = plain and not value[0].isdigit() and value.lower() not in NO_TEXTS
    return value if reads else json.dumps(value, ensure_ascii=False)


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
    before = "" if field == CONTENT else f"{field}."
    names = sorted(n for n in {*old, *new} if old.get(n) != new.get(n))
    return [Change(f"{before}{n}", MASK if n in old else None, MASK if n in new else None) for n in names]


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
        "Machine": {name: _fields(machine) for name, machine in catalog.machines.items()},
        "Request": {request.id: _fields(request) for request in catalog.requests},
        "Policy": {"": _fields(catalog.policy)},
    }


def _service(desired: Desired, name: str) -> dict[str, Any]:
    """Return the fields of a service, including container options and the content it mounts from the tree."""
    service = desired.catalog.services[name]
    extra = {CONTENT: dict(desired.contents.get(name, {})), PARAMETERS: dict(service.ros.values) if service.ros else {}}
    probes = {"ready": _probe_fields(service.ready), "live": _probe_fields(service.live)}
    return {**_fields(service), **probes, **_declared(service.options, service.secrets), **extra}


def _network_or_volume(declared: EngineObject) -> dict[str, Any]:
    """Return the fields of a network or volume."""
    return {"name": declared.called, "external": declared.external, **declared_options(declared)}


def _fields(resource: Any) -> dict[str, Any]:
    plain: dict[str, Any] = _plain({k: v for k, v in asdict(resource).items() if k not in UNTOLD})
    return plain


def _plain(value: Any) -> Any:
    return json.loads(json.dumps(value))
