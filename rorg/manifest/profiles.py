"""Profiles: options that several services share. The built-in ones are manifests too, in the folder `profiles` beside
this file."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, reduce
from graphlib import TopologicalSorter
from itertools import pairwise
from pathlib import Path
from typing import Any

from rorg.manifest.container import ContainerOptions
from rorg.manifest.documents import Source, read_source
from rorg.model.diagnostics import Diagnostic, Reading, unknown
from rorg.model.graph import cycles
from rorg.model.volumes import mounted_at

BUILT_IN = Path(__file__).with_name("profiles")
COMMON = "common"


@cache
def built_in_profiles() -> dict[str, Source]:
    """Profiles that come with rorg: common, plain, ros1, ros2, realtime, gpu, x11."""
    profiles = {}
    for path in sorted(BUILT_IN.glob("*.yaml")):
        text = path.read_text(encoding="utf-8")
        source, diagnostics = read_source(text, path, f"<built in>/{path.name}", path.parent)
        if source is None:
            raise AssertionError(f"built-in profile {path.name}: {diagnostics}")
        profiles[source.name] = source
    return profiles


@dataclass(frozen=True, slots=True)
class Origin:
    """The declarer of an option: a profile, or a part of the service's own manifest."""

    name: str
    built_in: bool = False
    profile: bool = True

    def __str__(self) -> str:
        return f"{'profile ' if self.profile else ''}{self.name}{' (built in)' if self.built_in else ''}"


SHIPPED = Origin(COMMON, built_in=True)
"""The built-in defaults."""
Origins = Mapping[str, tuple[Origin, ...]]
Layer = tuple[Origin, Mapping[str, Any]]
"""Options of a container, and what declares them."""


@dataclass(frozen=True)
class Merged:
    """A profile merged with everything that it extends; the more special one wins."""

    needs: tuple[Any, ...] = ()
    idle: Mapping[str, Any] = field(default_factory=dict)
    ready: Any = None
    live: Any = None
    restart: str | None = None
    without_hardware: bool = False
    alone: bool = False
    """It does not extend `common`."""
    container: Mapping[str, Any] = field(default_factory=dict)
    layers: tuple[Layer, ...] = ()
    """The options of each profile in it, the lowest first."""
    partial: bool = False
    """A profile in it is unknown or has mistakes, so options may be missing."""


def merge_options(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Merges options of two levels: mappings by key, lists appended without repeats, everything else replaced (like
    Compose merges files). The lists `entrypoint` and `test` of a healthcheck are replaced as a whole. Options of the
    lower level that contradict the upper level are dropped: another volume at the same path, another value for the same
    security option, another way into a network, options of another logging driver."""
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
    """Drops options for log rotation if the new driver writes no files: it would refuse them."""
    if over.get("driver", "json-file") in _ROTATING or "driver" not in over:
        return old
    return {**old, "options": {k: v for k, v in old.get("options", {}).items() if k not in _ROTATION}}


def _matter(option: str) -> str | None:
    """The subject of a value of security_opt: seccomp, apparmor, ...; None if several values may coexist."""
    name = re.split("[=:]", option, maxsplit=1)[0]
    return None if name == "label" else name


_PLACES: Mapping[str, Callable[[Any], str | None]] = {"volumes": mounted_at, "security_opt": _matter}
"""List option -> a key that only one of its items can have."""


def origins_of(container: Mapping[str, Any], layers: Iterable[Layer]) -> Origins:
    """Option of a container -> its declarers. `layers` are the options that were merged, the lowest first."""
    origins: dict[str, tuple[Origin, ...]] = {}
    for origin, options in layers:
        for option, value in options.items():
            for key in value if isinstance(value, dict) and option != "healthcheck" else ("",):
                path = f"{option}.{key}" if key else option
                appended = isinstance(value, list) and option != "entrypoint"
                origins[path] = tuple(dict.fromkeys((*origins.get(path, ()), origin))) if appended else (origin,)
    return {path: names for path, names in origins.items() if path.partition(".")[0] in container}


def declared(options: ContainerOptions | None) -> dict[str, Any]:
    """The options that were written, as plain JSON values."""
    return options.model_dump(exclude_unset=True, exclude_none=True, mode="json") if options else {}


class Profiles:
    """The merged profiles of a tree.

    `common` is applied once, below all profiles of a service and everything that they extend. So a later profile does
    not restore a value of `common` that an earlier one changes.
    """

    def __init__(self, said: Mapping[str, Merged], below: Collection[str]) -> None:
        self.said, self.below = said, below
        self._found: dict[tuple[str, ...], Merged] = {}

    def of(self, names: Sequence[str]) -> Merged:
        """The profiles that a service names, merged as one profile that extends them in this order; without any,
        `common`. Unknown names are ignored."""
        named = tuple(name for name in names if name in self.said) or (COMMON,)
        if not all(name in self.said for name in names):
            return replace(self.of(named), partial=True)
        if named not in self._found:
            merged = reduce(_over, (self.said[name] for name in named))
            whole = merged.alone or all(name in self.below for name in named)
            self._found[named] = merged if whole else _over(self.said[COMMON], merged)
        return self._found[named]


def merge_profiles(sources: Mapping[str, Source], broken: Collection[str] = ()) -> Reading[Profiles]:
    """Merges every profile with everything that it extends; unknown names and cycles in `extends` are errors.

    `common` is below all profiles, except those that say `common: false` or extend one that does. The profiles that
    `common` itself extends have nothing below them.
    """
    parents = yield from _parents(sources, broken)
    below = {COMMON}
    pending = [COMMON]
    while pending:
        more = set(parents[pending.pop()]) - below
        below |= more
        pending += more
    said: dict[str, Merged] = {}
    for name in TopologicalSorter(parents).static_order():
        said[name] = reduce(_over, [*(said[parent] for parent in parents[name]), _own(name, sources[name], sources)])
    return Profiles(said, below)


def _parents(sources: Mapping[str, Source], broken: Collection[str]) -> Reading[dict[str, list[str]]]:
    """The parents of each profile, in order. Unknown names and cycles are left out and reported."""
    graph: dict[str, list[str]] = {}
    for name, source in sources.items():
        for index, parent in enumerate(source.spec.extends):
            if parent not in sources and parent not in broken:
                yield unknown(source.where("spec", "extends", index), "profile", parent, sources)
        graph[name] = [parent for parent in source.spec.extends if parent in sources]
    rings = cycles(graph)
    for ring in rings:
        last = sources[ring[-2]]
        where = last.where("spec", "extends", last.spec.extends.index(ring[-1]))
        yield Diagnostic(where, f"profiles extend each other: {' -> '.join(ring)}", "to break the cycle")
    closing = {pair for ring in rings for pair in pairwise(ring)}
    return {n: [p for p in parents if (n, p) not in closing] for n, parents in graph.items()}


def _own(name: str, source: Source, known: Collection[str]) -> Merged:
    spec: Any = source.spec
    container = declared(spec.container)
    origin = Origin(name, built_in_profiles().get(name) is source)
    return Merged(
        needs=tuple(spec.needs),
        idle=spec.idle.model_dump(exclude_none=True) if spec.idle else {},
        ready=spec.ready,
        live=spec.live,
        restart=spec.restart,
        without_hardware=spec.without_hardware,
        alone=not spec.common,
        container=container,
        layers=((origin, container),),
        partial=source.partial or any(parent not in known for parent in spec.extends),
    )


def _over(base: Merged, top: Merged) -> Merged:
    return Merged(
        needs=tuple(dict.fromkeys(base.needs + top.needs)),
        idle={**base.idle, **top.idle},
        ready=top.ready or base.ready,
        live=top.live or base.live,
        restart=top.restart or base.restart,
        without_hardware=base.without_hardware or top.without_hardware,
        alone=base.alone or top.alone,
        container=merge_options(base.container, top.container),
        layers=_outermost(base.layers + top.layers),
        partial=base.partial or top.partial,
    )


def _outermost(layers: tuple[Layer, ...]) -> tuple[Layer, ...]:
    """The first and the last occurrence of each layer: those between change no origin, and profiles that extend two
    others each would double them at every step."""
    first: dict[Origin, int] = {}
    last: dict[Origin, int] = {}
    for at, (origin, _) in enumerate(layers):
        first.setdefault(origin, at)
        last[origin] = at
    kept = {*first.values(), *last.values()}
    return tuple(layer for at, layer in enumerate(layers) if at in kept)
