"""All small worlds: manifests of at most four services over a small alphabet, each once up to renaming.

A world is a set of features. Those of one service: how it idles, lingers, is always on, has probes, or defers its
changes. Those of two: one needs the other, restarts with it, conflicts with it, or shares an exclusive resource. Those
of three: they use units of a resource that has two.
"""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from bounded.virtual import WorldRobot
from robots import write_tree

from rorg.core.desired import Desired, desire
from rorg.core.observed import Container
from rorg.errors import Invalid
from rorg.manifest.load import load_or_raise
from rorg.tools.sim.engine import iso

PROBES = {"ready": {"tcp": 1234}, "live": {"tcp": 1234}}
SINGLE: Mapping[str, dict] = {
    "pause": {"idle": {"action": "pause"}},
    "escalate": {"idle": {"action": "pause", "escalate": {"after": "2s", "action": "stop"}}},
    "remove": {"idle": {"action": "remove"}},
    "linger": {"idle": {"linger": "2s"}},
    "always": {"always_on": True},
    "probe": PROBES,
    "deferred": {"update": {"when": "when_ceased"}},
}
"""Feature of one service -> what it adds to its manifest."""
DOUBLE = ("restart", "conflict", "gpu")
"""Features of two services, besides `needs`. A `restart` belongs to a need; the other two exclude one."""
TRIPLE: Mapping[str, tuple[int, int, int]] = {"bus": (1, 1, 1), "wide": (2, 1, 1)}
"""Feature of three services -> how many of the two units of the bus each of them uses."""
POLICIES = {"policy": {"resources": {"bus": 2}}}
Feature = tuple[str, ...]
"""Its name and the services, as `("needs", "1", "0")`: service 1 needs service 0."""
EDITIONS = ("0", "1", "bad")
"""Of a service's manifest: two that are well, and one whose container ends half a second after it starts."""


@dataclass(frozen=True)
class World:
    """Services by name, as their manifests say it at the beginning."""

    specs: Mapping[str, dict]
    label: str = ""

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(self.specs)

    @cached_property
    def manifests(self) -> Manifests:
        return Manifests(self)


@dataclass(frozen=True)
class State:
    """What the manifests of a world say now."""

    editions: tuple[str, ...]
    always: tuple[bool, ...]


@dataclass
class Manifests:
    """The loaded trees of a world, by state. A tree that is refused is None."""

    world: World
    known: dict[State, Desired | None] = field(default_factory=dict)
    bad: dict[str, str] = field(default_factory=dict)
    """Digests of the editions whose containers exit."""

    def first(self) -> State:
        specs = self.world.specs.values()
        return State(("0",) * len(specs), tuple(bool(s.get("always_on")) for s in specs))

    def load(self, state: State) -> Desired | None:
        if state not in self.known:
            self.known[state] = self._load(state)
        return self.known[state]

    def _load(self, state: State) -> Desired | None:
        specs = {}
        for name, edition, always in zip(self.world.names, state.editions, state.always, strict=True):
            edited = {"container": {"environment": {"EDITION": edition}}} if edition != "0" else {}
            specs[name] = {**self.world.specs[name], "always_on": always, **edited}
        with tempfile.TemporaryDirectory() as folder:
            try:
                desired = desire(load_or_raise(write_tree(Path(folder), specs, policies=POLICIES)))
            except Invalid:
                return None
        for name, edition in zip(self.world.names, state.editions, strict=True):
            if edition == "bad":
                self.bad[desired.digests[name]] = "exit"
        return desired


def begin(world: World) -> WorldRobot:
    """A robot in this world before its first pass, beside a container that names no service."""
    desired = world.manifests.load(world.manifests.first())
    robot = WorldRobot(desired.catalog)
    robot.desired = desired
    stranger = Container("f" * 64, "stranger", "", "running", started_at=iso(-10.0), created_at=iso(-10.0))
    robot.engine.containers[stranger.id] = stranger
    robot.engine.strangers = frozenset((stranger.id,))
    return robot


# -- enumeration ---------------------------------------------------------------------------------------------------


def worlds(services: int, features: int) -> Iterator[World]:
    """All worlds of so many services: every acyclic graph of needs, with at most so many other features. Each world
    comes once, up to renaming of its services. Worlds that rorg refuses are left out."""
    seen = set[tuple[Feature, ...]]()
    for needs in graphs(services):
        free = [f for f in slots(services, needs) if f[0] != "needs"]
        for count in range(features + 1):
            for chosen in itertools.combinations(free, count):
                found = (*needs, *chosen)
                canonical = canon(found, services)
                if canonical not in seen and sound(found):
                    seen.add(canonical)
                    world = World(specs_of(found, services), " ".join("".join(f) for f in found) or "plain")
                    if world.manifests.load(world.manifests.first()) is not None:
                        yield world


def graphs(services: int) -> Iterator[tuple[Feature, ...]]:
    """All acyclic graphs of needs whose services are in order: each needs only earlier ones."""
    edges = [("needs", str(b), str(a)) for a, b in itertools.combinations(range(services), 2)]
    for count in range(len(edges) + 1):
        yield from itertools.combinations(edges, count)


def slots(services: int, needs: tuple[Feature, ...]) -> list[Feature]:
    """All features that a graph of needs may have."""
    single = [(name, str(n)) for n in range(services) for name in SINGLE]
    related = {(a, b) for _, b, a in needs}
    pairs = [(str(a), str(b)) for a, b in itertools.combinations(range(services), 2)]
    single += [("restart", b, a) for a, b in pairs if (a, b) in related]
    single += [(name, a, b) for name in DOUBLE[1:] for a, b in pairs if (a, b) not in related]
    triples = [*itertools.permutations(map(str, range(services)), 3)]
    return single + sorted({_unordered((name, *t)) for name in TRIPLE for t in triples})


def sound(features: tuple[Feature, ...]) -> bool:
    """Whether no service has two ways to idle, or a needs edge twice."""
    ways = [f[1] for f in features if f[0] in ("pause", "escalate", "remove")]
    return len(ways) == len({*ways})


def canon(features: tuple[Feature, ...], services: int) -> tuple[Feature, ...]:
    """The same for all worlds that differ only in the names of their services."""
    return min(
        tuple(sorted(_renamed(feature, order) for feature in features))
        for order in itertools.permutations(map(str, range(services)))
    )


def _renamed(feature: Feature, order: tuple[str, ...]) -> Feature:
    name, *of = feature
    return _unordered((name, *(order[int(n)] for n in of)))


def _unordered(feature: Feature) -> Feature:
    """The same for all orders of services that the feature does not distinguish."""
    name, *of = feature
    if name in ("conflict", "gpu", "bus"):
        return name, *sorted(of)
    return (name, of[0], *sorted(of[1:])) if name == "wide" else feature


def specs_of(features: tuple[Feature, ...], services: int) -> dict[str, dict]:
    """The manifests of a world. A service is stopped when idle and ready after 300 ms unless its features differ."""
    specs = {f"s{n}": {"idle": {"action": "stop"}, "ready": {"delay": "300ms"}, "needs": []} for n in range(services)}
    restarts = {(f[1], f[2]) for f in features if f[0] == "restart"}
    for name, first, *more in features:
        spec = specs[f"s{first}"]
        if name in SINGLE:
            for key, value in SINGLE[name].items():
                spec[key] = {**spec[key], **value} if key == "idle" else value
        elif name == "needs":
            other = f"s{more[0]}"
            both = (first, more[0]) in restarts
            spec["needs"] = [*spec["needs"], {"service": other, "restart": True} if both else other]
        elif name == "conflict":
            spec["conflicts"] = [*spec.get("conflicts", ()), f"s{more[0]}"]
        elif name == "gpu":
            for one in (spec, specs[f"s{more[0]}"]):
                one["exclusive"] = {**one.get("exclusive", {}), "gpu": 1}
        elif name in TRIPLE:
            for service, units in zip((first, *more), TRIPLE[name], strict=True):
                specs[f"s{service}"]["exclusive"] = {**specs[f"s{service}"].get("exclusive", {}), "bus": units}
    return specs
