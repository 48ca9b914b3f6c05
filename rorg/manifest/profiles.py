"""Profiles: what several services share. Built-in ones are manifests too, in the folder beside this file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from rorg.manifest.container import ContainerOptions
from rorg.manifest.diagnostics import Diagnostic, nearest
from rorg.manifest.documents import Source, read_source

BUILT_IN = Path(__file__).with_name("profiles")
COMMON = "common"


@cache
def built_in_profiles() -> dict[str, Source]:
    """The profiles that come with rorg: common, ros1, ros2."""
    found = {}
    for path in sorted(BUILT_IN.glob("*.yaml")):
        source, diagnostics = read_source(path.read_text(encoding="utf-8"), path, f"<built in>/{path.name}")
        if source is None:
            raise AssertionError(f"built-in profile {path.name}: {diagnostics}")
        found[source.name] = source
    return found


@dataclass(frozen=True)
class Merged:
    """A profile with all that it extends, merged: the base first, the more special over it."""

    needs: tuple[Any, ...] = ()
    idle: Mapping[str, Any] = field(default_factory=dict)
    ready: Any = None
    live: Any = None
    restart: str | None = None
    without_hardware: bool = False
    container: Mapping[str, Any] = field(default_factory=dict)


def merge_options(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Options of two levels: mappings by key, lists appended without repeats, everything else replaced (as Compose
    merges files). `entrypoint` and a healthcheck's `test` are one thing though they are lists."""
    merged = dict(base)
    for key, value in over.items():
        old = merged.get(key)
        if isinstance(old, dict) and isinstance(value, dict) and key != "healthcheck":
            merged[key] = merge_options(old, value)
        elif isinstance(old, list) and isinstance(value, list) and key != "entrypoint":
            merged[key] = old + [item for item in value if item not in old]
        else:
            merged[key] = value
    return merged


def declared(options: ContainerOptions | None) -> dict[str, Any]:
    """Only what was written, as plain JSON values."""
    return options.model_dump(exclude_unset=True, exclude_none=True, mode="json") if options else {}


def merge_profiles(sources: Mapping[str, Source]) -> tuple[dict[str, Merged], list[Diagnostic]]:
    """Every profile by name, merged; with unknown names and cycles in `extends` as errors. `common` is under all."""
    diagnostics: list[Diagnostic] = []
    merged: dict[str, Merged] = {}

    def visit(name: str, trail: tuple[str, ...]) -> Merged:
        if name in merged:
            return merged[name]
        source, spec = sources[name], sources[name].spec
        # What `common` itself extends stands on nothing: it is what everything else stands on.
        based = COMMON in merged or COMMON not in (*trail, name)
        result = visit(COMMON, ()) if based and name != COMMON else Merged()
        for index, parent in enumerate(spec.extends):  # type: ignore[attr-defined]
            where = source.where("spec", "extends", index)
            if parent in (*trail, name):
                ring = (*trail, name, parent)
                cycle = " -> ".join(ring[ring.index(parent) :])
                diagnostics.append(Diagnostic(where, f"profiles extend each other: {cycle}", "to break the cycle"))
            elif parent not in sources:
                diagnostics.append(Diagnostic(where, f"unknown profile '{parent}'", nearest(parent, sources)))
            else:
                result = _over(result, visit(parent, (*trail, name)))
        merged[name] = _over(result, _own(spec))
        return merged[name]

    for name in sources:
        visit(name, ())
    return merged, diagnostics


def _own(spec: Any) -> Merged:
    return Merged(
        needs=tuple(spec.needs),
        idle=spec.idle.model_dump(exclude_none=True) if spec.idle else {},
        ready=spec.ready,
        live=spec.live,
        restart=spec.restart,
        without_hardware=spec.without_hardware,
        container=declared(spec.container),
    )


def _over(base: Merged, top: Merged) -> Merged:
    return Merged(
        needs=tuple(dict.fromkeys(base.needs + top.needs)),
        idle={**base.idle, **top.idle},
        ready=top.ready or base.ready,
        live=top.live or base.live,
        restart=top.restart or base.restart,
        without_hardware=base.without_hardware or top.without_hardware,
        container=merge_options(base.container, top.container),
    )
