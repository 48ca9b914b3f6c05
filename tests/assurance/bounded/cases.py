"""Failing worlds as small files in tests/cases/worlds, which a test replays."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path as File

from bounded.explore import Found, Path, replay
from bounded.worlds import World
from common import ROOT

CASES = ROOT / "tests/cases/worlds"


def shrink(found: Found) -> Found:
    """Return a smaller way to break the same promise: fewer steps, and services with fewer fields."""
    while True:
        smaller = next(filter(None, (_breaks(found, *one) for one in _smaller(found))), None)
        if smaller is None:
            return found
        found = smaller


def _breaks(found: Found, world: World, path: Path) -> Found | None:
    """Return what a world and path break, if it is the same promise."""
    try:
        other = replay(world, path)
    except (KeyError, AttributeError):  # such a tree is refused
        return None
    return other if other and other.violation.name == found.violation.name else None


def _smaller(found: Found) -> Iterator[tuple[World, Path]]:
    for index in range(len(found.path)):
        yield found.world, (*found.path[:index], *found.path[index + 1 :])
    specs = found.world.specs
    last = len(specs) - 1
    if last and all(last not in step[1:] for step, _ in found.path):
        yield World(dict([*specs.items()][:-1]), found.world.label), found.path
    for name, spec in specs.items():
        for field in spec:
            less = {key: value for key, value in spec.items() if key != field}
            yield World({**specs, name: less}, found.world.label), found.path


def save(found: Found, folder: File = CASES) -> File:
    """Write a case, named after the promise that it broke."""
    name = found.violation.name.replace(" ", "_")
    number = next(n for n in range(1, 1000) if not (folder / f"{name}_{n}.json").exists())
    path = folder / f"{name}_{number}.json"
    steps = [[*step, pause] for step, pause in found.path]
    path.write_text(
        json.dumps({"broke": str(found.violation), "services": found.world.specs, "steps": steps}, indent=1)
    )
    return path


def load(path: File) -> tuple[World, Path]:
    """Read a case."""
    found: Mapping = json.loads(path.read_text())
    return World(found["services"], path.stem), tuple((tuple(s[:-1]), s[-1]) for s in found["steps"])
