"""Which declared fields of a service a container has otherwise, with the values of before and after, for people."""

from __future__ import annotations

import json
import shlex
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

from rorg.core.diff import Difference
from rorg.core.digest import declared_fields, declared_of
from rorg.core.masking import MASK, masked
from rorg.core.normal import normal, normal_fields
from rorg.core.observed import Container
from rorg.model.catalog import Spec
from rorg.model.options import LIVE
from rorg.model.units import format_memory

LONG = 60
"""Characters of a value in one line."""
CONTEXT = 16
"""Characters that are shown before the first one that differs, where a value is cut."""
ORDERED = ("command", "entrypoint")
"""Lists that are one thing, rather than several."""
BYTES = ("mem_limit", "mem_reservation", "memswap_limit", "shm_size")


@dataclass(frozen=True, slots=True)
class Change:
    """Values are as they may be shown; None where there is none."""

    field: str
    old: Any
    new: Any

    def __str__(self) -> str:
        """In one line."""
        if self.old == self.new:
            return f"{self.field} changed"
        if MASK in (self.old, self.new):
            return f"{self.field} {'added' if self.old is None else 'removed' if self.new is None else 'changed'}"
        if isinstance(self.old or self.new, list) and self.field not in ORDERED:
            was, now = self.old or [], self.new or []
            told = [f"+ {_shown(v)}" for v in now if v not in was] + [f"- {_shown(v)}" for v in was if v not in now]
            return f"{self.field}: {', '.join(told)}" if told else f"{self.field}: another order"
        if self.field in BYTES:
            return f"{self.field}: {_bytes(self.old)} -> {_bytes(self.new)}"
        old, new = _cut_to_difference(_shown(self.old), _shown(self.new))
        return f"{self.field}: {old} -> {new}"

    def as_json(self) -> dict[str, Any]:
        return {"field": self.field, "old": self.old, "new": self.new, "text": str(self)}


def changed_fields(
    container: Container, spec: Spec, difference: Difference, secrets: Collection[str] = ()
) -> tuple[Change, ...]:
    """`difference` is that of these two; `secrets` names variables of the spec."""
    was, now = declared_of(container.declared), _fields(spec, secrets)
    found = [c for k in difference.recreate for c in field_changes(k, was.get(k), now.get(k))]
    found += [Change(k, container.live.get(k), v) for k, v in sorted(difference.live.items())]
    return tuple(found)


def changes_between(was: Mapping[str, Any], now: Mapping[str, Any]) -> tuple[Change, ...]:
    """Of two records of what a container was made from."""
    then, there = normal_fields(was), normal_fields(now)
    names = sorted(k for k in {*then, *there} if then.get(k) != there.get(k))
    return tuple(c for k in names for c in field_changes(k, was.get(k), now.get(k)))


def unified(name: str, container: Container | None, spec: Spec | None, secrets: Collection[str] = ()) -> str:
    """What a container was made from and what is declared, as a unified diff with secrets masked; empty where nothing
    differs. None stands for nothing."""
    from difflib import unified_diff

    was, now = {} if container is None else _as_it_is(container), {} if spec is None else dict(_fields(spec, secrets))
    was = {k: now[k] if k in now and normal(k, v) == normal(k, now[k]) else v for k, v in was.items()}
    before = f"{name} ({f'container {container.id[:12]}' if container else 'no container'})"
    after = f"{name} ({'no manifest' if spec is None else 'manifests'})"
    lines = unified_diff(_lines(was, now, "before"), _lines(now, was, "after"), before, after, lineterm="")
    return "".join(f"{line.rstrip()}\n" for line in lines)


def _fields(spec: Spec, secrets: Collection[str]) -> Mapping[str, Any]:
    """As the record of a container made from it has them."""
    found: Mapping[str, Any] = json.loads(json.dumps(declared_fields(spec, secrets)))
    return found


def _as_it_is(container: Container) -> dict[str, Any]:
    """What it was made from, with what was set on it since."""
    was = dict(declared_of(container.declared))
    live = {k: v for k, v in container.live.items() if k in LIVE and k in was and v is not None}
    return {**was, **live}


def field_changes(field: str, old: Any, new: Any) -> list[Change]:
    """One for each entry of a mapping that differs."""
    if all(isinstance(value, dict | None) for value in (old, new)) and (old or new):
        was, now = old or {}, new or {}
        keys = sorted(k for k in {*was, *now} if was.get(k) != now.get(k))
        return [c for k in keys for c in field_changes(f"{field}.{k}", was.get(k), now.get(k))]
    return [Change(field, masked(field, old), masked(field, new))]


def _shown(value: Any) -> str:
    if value is None:
        return "(unset)"
    if isinstance(value, list) and all(isinstance(v, str) for v in value):
        return shlex.join(value)
    return value if isinstance(value, str) and value else json.dumps(value, ensure_ascii=False)


def _bytes(value: Any) -> str:
    return format_memory(value) if isinstance(value, int) and value >= 0 else _shown(value)


def _cut_to_difference(old: str, new: str) -> tuple[str, str]:
    """Both whole, or, where they are long, the part in which they begin to differ."""
    same = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(old, new, strict=False)))
    begin = 0 if max(len(old), len(new)) <= LONG else max(0, same - CONTEXT)
    return _part(old, begin), _part(new, begin)


def _part(text: str, begin: int) -> str:
    return "..." * bool(begin) + text[begin : begin + LONG] + "..." * (len(text) > begin + LONG)


def _lines(fields: Mapping[str, Any], other: Mapping[str, Any], word: str) -> list[str]:
    """As YAML. A value that differs from the `other` one in what is masked is marked with a word."""
    found = []
    for name, value in sorted(fields.items()):
        shown = masked(name, value)
        hidden = name in other and value != other[name] and shown == masked(name, other[name])
        found += [*_yaml(name, shown), *([f"  # {word}"] if hidden else [])]
    return found


def _yaml(name: str, value: Any) -> list[str]:
    if value and isinstance(value, list):
        return [f"{name}:", *(f"  - {_scalar(item)}" for item in value)]
    if value and isinstance(value, dict):
        return [f"{name}:", *(f"  {key}: {_scalar(item)}" for key, item in sorted(value.items()))]
    return [f"{name}: {_scalar(value)}"]


def _scalar(value: Any) -> str:
    """JSON is YAML; what reads the same without quotes has none."""
    plain = isinstance(value, str) and value.replace("/", "").replace("_", "").replace("-", "").isalnum()
    return value if plain and not value[0].isdigit() else json.dumps(value, ensure_ascii=False)
