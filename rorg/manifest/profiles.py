"""Profiles: what several services share. Built-in ones are manifests too, in the folder beside this file."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, reduce
from graphlib import TopologicalSorter
from itertools import pairwise
from pathlib import Path
from typing import Any

from rorg.manifest.container import ContainerOptions
from rorg.manifest.documents import Source, read_source
from rorg.model.diagnostics import Diagnostic, nearest
from rorg.model.graph import cycles
from rorg.model.volumes import mounted_at

BUILT_IN = Path(__file__).with_name("profiles")
COMMON = "common"


@cache
def built_in_profiles() -> dict[str, Source]:
    """The profiles that come with rorg: common, plain, ros1, ros2, realtime, gpu, x11."""
    found = {}
    for path in sorted(BUILT_IN.glob("*.yaml")):
        source, diagnostics = read_source(
            path.read_text(encoding="utf-8"), path, f"<built in>/{path.name}", path.parent
        )
        if source is None:
            raise AssertionError(f"built-in profile {path.name}: {diagnostics}")
        found[source.name] = source
    return found


@dataclass(frozen=True, slots=True)
class Origin:
    """What declares an option: a profile, or a part of the service's own manifest."""

    name: str
    built_in: bool = False
    profile: bool = True

    def __str__(self) -> str:
        return f"{'profile ' if self.profile else ''}{self.name}{' (built in)' if self.built_in else ''}"


SHIPPED = Origin(COMMON, built_in=True)
"""The defaults that nobody asked for."""
Origins = Mapping[str, tuple[Origin, ...]]


@dataclass(frozen=True)
class Merged:
    """A profile with all that it extends, merged: the base first, the more special over it."""

    needs: tuple[Any, ...] = ()
    idle: Mapping[str, Any] = field(default_factory=dict)
    ready: Any = None
    live: Any = None
    restart: str | None = None
    without_hardware: bool = False
    alone: bool = False
    """It wants nothing of `common`."""
    container: Mapping[str, Any] = field(default_factory=dict)
    origins: Origins = field(default_factory=dict)
    """Option of the container -> what declares it."""


def merge_options(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Options of two levels: mappings by key, lists appended without repeats, everything else replaced (as Compose
    merges files). `entrypoint` and a healthcheck's `test` are one thing though they are lists. What cannot stand
    beside what the upper level says is left out: another volume at the same place, another word on the same matter of
    security, another way into a network, options of another driver of logs."""
    merged = {k: v for k, v in base.items() if not (k in _ONE_OF and _ONE_OF[k] in over and k not in over)}
    for key, value in over.items():
        old = merged.get(key)
        if isinstance(old, dict) and isinstance(value, dict) and key != "healthcheck":
            merged[key] = _merge_keys(_same_driver(old, value) if key == "logging" else old, value)
        elif isinstance(old, list) and isinstance(value, list) and key != "entrypoint":
            new = [item for item in value if item not in old]
            place = _PLACES.get(key, lambda _: None)
            taken = {place(item) for item in new} - {None}
            merged[key] = [item for item in old if place(item) not in taken] + new
        else:
            merged[key] = value
    return merged


def _merge_keys(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    nested = {
        k: _merge_keys(base[k], v) for k, v in over.items() if isinstance(v, dict) and isinstance(base.get(k), dict)
    }
    lists = {
        k: base[k] + [item for item in v if item not in base[k]]
        for k, v in over.items()
        if isinstance(v, list) and isinstance(base.get(k), list)
    }
    return {**base, **over, **nested, **lists}


_ONE_OF = {"network_mode": "networks", "networks": "network_mode"}
_ROTATING = frozenset(("json-file", "local", "none"))
_ROTATION = frozenset(("max-size", "max-file", "compress"))


def _same_driver(old: Mapping[str, Any], over: Mapping[str, Any]) -> Mapping[str, Any]:
    """Drivers that write no files refuse to be told when to begin a new one."""
    if over.get("driver", "json-file") in _ROTATING or "driver" not in over:
        return old
    return {**old, "options": {k: v for k, v in old.get("options", {}).items() if k not in _ROTATION}}


def _matter(option: str) -> str | None:
    """What a value of security_opt is about: seccomp, apparmor, ...; None where several may stand beside each other."""
    name = re.split("[=:]", option, maxsplit=1)[0]
    return None if name == "label" else name


_PLACES: Mapping[str, Callable[[Any], str | None]] = {"volumes": mounted_at, "security_opt": _matter}
"""Option that is a list -> what only one item of it can be at."""


def trace(origins: Origins, container: Mapping[str, Any], over: Mapping[str, Any], origin: Origin) -> Origins:
    """Where the options of `container` come from, after `over` was put on what `origins` tells of."""
    paths = [
        f"{option}.{key}" if key else option
        for option, value in over.items()
        for key in (value if isinstance(value, dict) and option != "healthcheck" else ("",))
    ]
    return _put(origins, container, dict.fromkeys(paths, (origin,)))


def _put(origins: Origins, container: Mapping[str, Any], over: Origins) -> Origins:
    found = {path: names for path, names in origins.items() if path.partition(".")[0] in container}
    for path, names in over.items():
        appended = isinstance(container.get(path), list) and path != "entrypoint"
        found[path] = tuple(dict.fromkeys((*found.get(path, ()), *names))) if appended else names
    return {path: names for path, names in found.items() if path.partition(".")[0] in container}


def declared(options: ContainerOptions | None) -> dict[str, Any]:
    """Only what was written, as plain JSON values."""
    return options.model_dump(exclude_unset=True, exclude_none=True, mode="json") if options else {}


class Profiles:
    """The profiles of a tree, merged. `common` is laid once, under all that one says together with what it extends: so
    a later one of several does not bring back what an earlier one says otherwise than `common`."""

    def __init__(self, said: Mapping[str, Merged], below: Collection[str]) -> None:
        self.said, self.below = said, below
        self._found: dict[tuple[str, ...], Merged] = {}

    def of(self, names: Sequence[str]) -> Merged:
        """Those that a service names and that there are: one, or as one that extends them in this order; else
        `common`."""
        named = tuple(name for name in names if name in self.said) or (COMMON,)
        if named not in self._found:
            found = reduce(_over, (self.said[name] for name in named))
            whole = found.alone or all(name in self.below for name in named)
            self._found[named] = found if whole else _over(self.said[COMMON], found)
        return self._found[named]


def merge_profiles(sources: Mapping[str, Source]) -> tuple[Profiles, list[Diagnostic]]:
    """Every profile with all that it extends; with unknown names and cycles in `extends` as errors. `common` is under
    all that do not say `common: false`, and do not extend one that does; what it extends itself stands on nothing."""
    parents, diagnostics = _parents(sources)
    below = {COMMON}
    pending = [COMMON]
    while pending:
        more = set(parents[pending.pop()]) - below
        below |= more
        pending += more
    said: dict[str, Merged] = {}
    for name in TopologicalSorter(parents).static_order():
        said[name] = reduce(_over, [*(said[parent] for parent in parents[name]), _own(name, sources[name])])
    return Profiles(said, below), diagnostics


def _parents(sources: Mapping[str, Source]) -> tuple[dict[str, list[str]], list[Diagnostic]]:
    """What each profile extends, in order. Unknown names, and what leads in a circle, are left out, and told."""
    diagnostics: list[Diagnostic] = []
    graph: dict[str, list[str]] = {}
    for name, source in sources.items():
        for index, parent in enumerate(source.spec.extends):
            if parent not in sources:
                where = source.where("spec", "extends", index)
                diagnostics.append(Diagnostic(where, f"unknown profile '{parent}'", nearest(parent, sources)))
        graph[name] = [parent for parent in source.spec.extends if parent in sources]
    rings = cycles(graph)
    for ring in rings:
        last = sources[ring[-2]]
        where = last.where("spec", "extends", last.spec.extends.index(ring[-1]))
        what = f"profiles extend each other: {' -> '.join(ring)}"
        diagnostics.append(Diagnostic(where, what, "breaking the cycle"))
    closing = {pair for ring in rings for pair in pairwise(ring)}
    return {n: [p for p in found if (n, p) not in closing] for n, found in graph.items()}, diagnostics


def _own(name: str, source: Source) -> Merged:
    spec: Any = source.spec
    container = declared(spec.container)
    return Merged(
        needs=tuple(spec.needs),
        idle=spec.idle.model_dump(exclude_none=True) if spec.idle else {},
        ready=spec.ready,
        live=spec.live,
        restart=spec.restart,
        without_hardware=spec.without_hardware,
        alone=not spec.common,
        container=container,
        origins=trace({}, container, container, Origin(name, built_in_profiles().get(name) is source)),
    )


def _over(base: Merged, top: Merged) -> Merged:
    container = merge_options(base.container, top.container)
    return Merged(
        needs=tuple(dict.fromkeys(base.needs + top.needs)),
        idle={**base.idle, **top.idle},
        ready=top.ready or base.ready,
        live=top.live or base.live,
        restart=top.restart or base.restart,
        without_hardware=base.without_hardware or top.without_hardware,
        alone=base.alone or top.alone,
        container=container,
        origins=_put(base.origins, container, top.origins),
    )
