"""The digest of a declared container, and the labels in which a container carries what it was made from.

Labels are rorg's only record of a container. A state directory can be lost; the labels stay with the container.

A secret in a label is written as `***(HASH)`. Equal secrets have equal marks, so rorg can still compare a container
with what is declared, and declaring a value secret replaces no container. The hash hides a long secret only: a
person who may read the labels of the engine can find a short one by trying all. masking.py decides what people see.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from rorg.core.masking import MARK, MASK, secrets_of
from rorg.core.observed import (
    LABEL_DECLARED,
    LABEL_DEVICES,
    LABEL_JOINED,
    LABEL_OWNER,
    LABEL_PREVIOUS,
    LABEL_RULES,
    LABEL_SERVICE,
    LABEL_SPEC,
    Container,
)
from rorg.model.catalog import SHORTEST_SECRET, Spec
from rorg.model.probe import Probe

VERSION = "v1"
INTERLOCKS = ("tcp", "http", "file")
"""Probe kinds that only ask this machine. Nothing else may be run because a label says so."""
_CANONICAL = json.JSONEncoder(sort_keys=True, separators=(",", ":"), ensure_ascii=False)


def canonical(value: Any) -> str:
    """Return the canonical JSON of a value: sorted keys, no white space."""
    return _CANONICAL.encode(value)


def digest(spec: Spec) -> str:
    """Return the identity of a rendered container: "v1:" and 32 hexadecimal digits over its canonical JSON.

    The version names the algorithm. A new rorg must give the same digest for the same manifests; otherwise an upgrade
    would replace every container of a robot.
    """
    return f"{VERSION}:{hashlib.sha256(canonical(spec).encode()).hexdigest()[:32]}"


def declared_fields(spec: Spec, secrets: Collection[str] = ()) -> dict[str, Any]:
    """Return the spec by field, with each environment variable as a field of its own. Their values are only hashed:
    they may be secret, and the result ends up in labels and plans. `secrets` names secret variables, whose values are
    also masked in other fields."""
    values = secrets_of(spec, secrets)
    fields = {k: marked(k, v, values) for k, v in spec.items() if k != "environment"}
    for name, value in spec.get("environment", {}).items():
        fields[f"environment.{name}"] = "sha256:" + hashlib.sha256(value.encode()).hexdigest()[:12]
    return fields


@dataclass(frozen=True, slots=True)
class Rules:
    """What other services may rely on as long as a container exists, even after its manifest is gone."""

    interlock: Probe | None = None
    exclusive: Mapping[str, int] = field(default_factory=dict)
    conflicts: tuple[str, ...] = ()
    """Conflicting services, whichever side declared it."""


def labels(
    owner: str,
    service: str,
    spec: Spec,
    made_from: str,
    rules: Rules,
    *,
    previous: str = "",
    secrets: Collection[str] = (),
    joined: Mapping[str, str] | None = None,
    devices: str = "",
) -> Mapping[str, str]:
    """Return the labels that mark a container as ours and record what it was made from.

    - `made_from`: the digest of its spec;
    - `previous`: id of the container that it replaces;
    - `secrets`: variables whose values must not be readable;
    - `joined`: service -> id of its container, whose namespaces or volumes this one uses;
    - `devices`: the device nodes it is given.
    """
    return {
        **spec.get("labels", {}),
        LABEL_OWNER: owner,
        LABEL_SERVICE: service,
        LABEL_SPEC: made_from,
        LABEL_DECLARED: canonical(declared_fields(spec, secrets)),
        **({} if rules == Rules() else {LABEL_RULES: _write_rules(rules)}),
        **({LABEL_PREVIOUS: previous} if previous else {}),
        **({LABEL_DEVICES: devices} if devices else {}),
        **({LABEL_JOINED: canonical(joined)} if joined else {}),
    }


def _write_rules(rules: Rules) -> str:
    lock = rules.interlock
    return canonical(
        {
            "interlock": [lock.kind, lock.target, lock.interval] if lock else None,
            "exclusive": dict(rules.exclusive),
            "conflicts": list(rules.conflicts),
        }
    )


@lru_cache(maxsize=1024)
def declared_of(label: str) -> Mapping[str, Any]:
    """Return the content of the label rorg.io/declared; empty if it is unreadable."""
    try:
        value = json.loads(label)
    except (ValueError, RecursionError):
        return {}
    return value if isinstance(value, dict) else {}


@lru_cache(maxsize=1024)
def rules_of(label: str) -> Rules:
    """Return the content of the label rorg.io/rules; no rules if it is unreadable."""
    try:
        value = json.loads(label)
        lock = value["interlock"]
        if lock and lock[0] not in INTERLOCKS:
            return Rules()
        return Rules(
            Probe(str(lock[0]), str(lock[1]), interval=max(0.05, min(3600.0, float(lock[2])))) if lock else None,
            {str(k): int(v) for k, v in value["exclusive"].items()},
            tuple(map(str, value["conflicts"])),
        )
    except (ValueError, TypeError, LookupError, AttributeError, OverflowError, RecursionError):
        return Rules()


def unreadable(container: Container) -> str:
    """Return what is wrong with a container's labels and what follows from that; "" if nothing is."""
    if not container.service:
        return f"{container.error or f'its label {LABEL_SERVICE} names no service'}: it is left alone"
    if container.rules and rules_of(container.rules) == Rules():
        return f"its label {LABEL_RULES} cannot be read: it holds nothing back once its manifest is gone"
    if container.declared and not declared_of(container.declared):
        return f"its label {LABEL_DECLARED} cannot be read: the container is replaced if its digest differs"
    return ""


READ_BACK = ("image", "container_name", "volumes", "stop_signal", "stop_grace_period")
"""Options that rorg reads back from a container's label, so they are stored unmasked."""


def marked(option: str, value: Any, values: Iterable[str]) -> Any:
    """Return an option for a container's label, with secrets replaced by marks."""
    marks = [(v, f"{MASK}({_hash(v)})") for v in sorted(values, key=len, reverse=True) if len(v) >= SHORTEST_SECRET]
    return _marked(value, marks) if marks and option not in READ_BACK else value


def _marked(value: Any, marks: list[tuple[str, str]]) -> Any:
    if isinstance(value, str):
        for secret, mark in marks:
            value = value.replace(secret, mark)
        return value
    if isinstance(value, dict):
        return {key: _marked(item, marks) for key, item in value.items()}
    return [_marked(item, marks) for item in value] if isinstance(value, list) else value


def same(a: Any, b: Any) -> bool:
    """Return whether two options are equal, comparing marks with the plain text they stand for. So declaring a value
    secret, or no longer secret, replaces no container."""
    if isinstance(a, str) and isinstance(b, str):
        return a == b or _stands_for(a, b) or _stands_for(b, a)
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(same, a, b))
    return bool(a == b)


def _stands_for(with_marks: str, plain: str) -> bool:
    prefix, *rest = MARK.split(with_marks)
    if len(rest) != 2 or len(plain) < len(prefix) + len(rest[1]):
        return False
    secret = plain.removeprefix(prefix).removesuffix(rest[1])
    return plain == prefix + secret + rest[1] and _hash(secret) == rest[0]


def _hash(value: str) -> str:
    return hashlib.sha256(value.encode()).hexdigest()[:12]
