"""Keeps what the last good tree declared. The next rorg then knows what has been removed from it, and begins with it if
the tree has errors by then."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, is_dataclass
from functools import cache, partial
from itertools import repeat
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from rorg.model.catalog import Catalog, Group, Request, Service
from rorg.model.former import Former, Kept
from rorg.store.files import write_atomic
from rorg.store.state_dir import read_json

NAME = ".services.last-good.json"
UNREADABLE = (ValueError, LookupError, TypeError, AttributeError, RecursionError)
"""What a file raises that another version wrote, or that was damaged."""
RETIRED = frozenset(("prewarm",))
"""Fields that an earlier version wrote and that have no effect. An upgrade that refused them would forget what was
removed from the tree, and could not begin with a tree that has errors."""
T = TypeVar("T")


def write_kept(folder: Path, kept: Kept) -> None:
    """Only the owner may read the file: it has values of the environment."""
    if kept.catalog is None:
        return
    former = [
        {**_dump(f.what), "needed_by": f.needed_by, "groups": f.groups, "withheld": f.withheld}
        for f in kept.former.values()
    ]
    content = {"last": asdict(kept.catalog), "former": former}
    write_atomic(folder / NAME, json.dumps({"digest": _digest(content), **content}) + "\n", mode=0o600)


def read_kept(folder: Path) -> Kept:
    """The last written content; nothing if the file was damaged. Entries that this version does not understand are
    ignored."""
    try:
        content = _content(folder)
        services = _each(content["last"]["services"].values(), partial(_value, Service))
        groups = _each(content["last"]["groups"].values(), partial(_value, Group))
        requests = _each(content["last"]["requests"], partial(_value, Request))
        former = _each(content["former"], _former)
    except UNREADABLE:
        return Kept()
    catalog = Catalog({s.name: s for s in services}, {g.name: g for g in groups}, requests=tuple(requests))
    return Kept(catalog, {f.what.name: f for f in former})


def read_last_catalog(folder: Path) -> Catalog | None:
    """The whole Catalog that was in force last; None if there is none, if the file was damaged, or if another version
    wrote it whose Catalog is different."""
    try:
        catalog: Catalog = _value(Catalog, _content(folder)["last"])
    except UNREADABLE:
        return None
    return catalog


def _content(folder: Path) -> dict[str, Any]:
    """Raises ValueError if the file was damaged, LookupError if there is none."""
    content: dict[str, Any] = read_json(folder / NAME) or {}
    if content.pop("digest", "") != _digest(content):
        raise ValueError(f"{NAME} is damaged")
    return content


def _digest(content: Mapping[str, Any]) -> str:
    """Detects damage anywhere in the file."""
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


def _dump(what: Service | Group) -> dict[str, Any]:
    return {"service" if isinstance(what, Service) else "group": asdict(what)}


def _each(entries: Iterable[Any], read: Callable[[Any], T]) -> list[T]:
    values = []
    for entry in entries:
        try:
            values.append(read(entry))
        except (TypeError, LookupError, AttributeError, ValueError):
            continue
    return values


def _former(entry: Mapping[str, Any]) -> Former:
    return Former(_load(entry), tuple(entry["needed_by"]), tuple(entry["groups"]), str(entry["withheld"]))


def _load(entry: Mapping[str, Any]) -> Service | Group:
    kind = Service if entry.get("service") else Group
    definition: Service | Group = _value(kind, entry["service" if kind is Service else "group"])
    return definition


def _value(kind: Any, plain: Any) -> Any:
    """The value of a type of the model that asdict() and JSON made plain. Raises TypeError and LookupError for what it
    does not have."""
    kinds = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    if isinstance(plain, list):
        items = next((get_args(k) for k in kinds if get_origin(k) is tuple), (Any, ...))
        each = repeat(items[0]) if items[1:] == (...,) else items
        return tuple(map(_value, each, plain))
    if isinstance(plain, dict):
        made: Any = next(filter(is_dataclass, kinds), None)
        if made:
            return made(**{name: _value(_hints(made)[name], v) for name, v in plain.items() if name not in RETIRED})
        values = next((get_args(k)[1] for k in kinds if get_origin(k) is Mapping), Any)
        return plain if values is Any else {name: _value(values, value) for name, value in plain.items()}
    return plain


@cache
def _hints(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind)
