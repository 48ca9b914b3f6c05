"""Random worlds for walks: up to five services with features that the complete worlds (worlds.py) leave out, and with
mounted files.

The trees of a world are read by rorg once. What a person edits afterwards changes a container or the content of a file,
so it is put into the catalog that was read.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path

import yaml
from bounded.worlds import POLICIES, SINGLE, TRIPLE, Feature, World, specs_of
from robots import DUMPER, WORK

from rorg.core.desired import Desired, desire
from rorg.manifest.load import load
from rorg.model.catalog import Catalog
from rorg.model.probe import Probe

DEVICE = "/dev/arm"
MORE_SINGLE: Mapping[str, dict] = {
    **SINGLE,
    "stops": {"idle": {"action": "pause", "escalate": {"after": "1s", "action": "remove"}}},
    "baked": {"update": {"bake": "5s"}},
    "unbaked": {"update": {"bake": "0s"}},
    "high": {"priority": 80},
    "low": {"priority": 20},
    "driver": {"driver": {"devices": [DEVICE]}},
    "kept": {"driver": {"devices": [DEVICE], "unplugged": "keep"}},
    "locked": {"interlock": {"file": "/allow"}},
    "file": {},
    "reload": {"on_change": "signal SIGHUP"},
}
"""Feature of one service -> what it adds to its manifest. `file` and `reload`: it mounts a file of the tree."""
FILES = ("file", "reload")
IDLING = ("pause", "escalate", "stops", "remove")
JOINS = ("network_mode", "pid")
MOST_SERVICES, MOST_FEATURES = 5, 5
NEEDED, PROBED = 0.3, 0.3
"""How often a service needs an earlier one, and how often it has probes."""
BAD = ("bad", "refused")
"""Editions whose containers end, or that the engine does not start. A file may be bad too: its reader ends."""
DEAF = "127.0.0.1:99"
"""Where nothing answers."""
PROBES: Mapping[str, Mapping[str, str]] = {
    "0": {},
    "1": {"ready": "127.0.0.1:2", "live": "127.0.0.1:2"},
    "ready": {"ready": DEAF},
    "live": {"live": DEAF},
}
"""What is edited of probes: role -> what it asks instead. The last two are bad."""
BAD_PROBES = ("ready", "live")


@dataclass(frozen=True)
class Edits:
    """What the manifests and files of a world say now: the edition of each, and who is always on."""

    editions: tuple[str, ...]
    files: tuple[str, ...]
    probes: tuple[str, ...]
    always: tuple[bool, ...]

    def bad(self, index: int) -> bool:
        """Return whether no container of a service stays well."""
        return self.editions[index] in BAD or self.files[index] in BAD or self.bad_probe(index)

    def bad_probe(self, index: int) -> bool:
        """Return whether nothing answers a probe of a service."""
        return self.probes[index] in BAD_PROBES


@dataclass(frozen=True)
class WalkWorld(World):
    """A world with files and probes. `files`: services that mount one; `probed`: those with probes."""

    files: frozenset[str] = frozenset()

    @property
    def probed(self) -> set[str]:
        return {name for name, spec in self.specs.items() if "live" in spec}

    @cached_property
    def trees(self) -> Trees:
        return Trees(self)


@dataclass
class Trees:
    """The desired states of a world, by what is edited. A tree that rorg refuses is None."""

    world: WalkWorld
    read: dict[tuple[bool, ...], Catalog | None] = field(default_factory=dict)
    known: dict[Edits, Desired | None] = field(default_factory=dict)
    bad: dict[str, str] = field(default_factory=dict)
    """Digests of bad editions -> how their containers fail."""

    def first(self) -> Edits:
        specs = self.world.specs.values()
        none = ("0",) * len(specs)
        return Edits(none, none, none, tuple(bool(s.get("always_on")) for s in specs))

    def load(self, edits: Edits) -> Desired | None:
        if edits not in self.known:
            if edits.always not in self.read:
                self.read[edits.always] = self._read(edits.always)
            catalog = self.read[edits.always]
            self.known[edits] = catalog and self._edited(catalog, edits)
        return self.known[edits]

    def _read(self, always: tuple[bool, ...]) -> Catalog | None:
        texts: dict[Path, str | None] = {}
        root = Path(__file__).parent  # it holds no manifests: all of them are given as texts, as of an editor
        services = {n: {**s, "always_on": on} for (n, s), on in zip(self.world.specs.items(), always, strict=True)}
        for folder, kind, specs in (("services", "Service", services), ("policies", "Policy", POLICIES)):
            for name, spec in specs.items():
                spec = {"image": "rorg-base", "command": WORK, **spec} if kind == "Service" else spec
                document = {"apiVersion": "rorg/v1", "kind": kind, "metadata": {"name": name}, "spec": spec}
                texts[root / folder / f"{name}.yaml"] = yaml.dump(document, Dumper=DUMPER, sort_keys=False)
        return load(root, texts).catalog

    def _edited(self, catalog: Catalog, edits: Edits) -> Desired:
        services = dict(catalog.services)
        for name, edition in zip(self.world.names, edits.editions, strict=True):
            service = services[name]
            if edition != "0" and service.spec is not None:
                environment = {**service.spec.get("environment", {}), "EDITION": edition}
                services[name] = replace(service, spec={**service.spec, "environment": environment})
        for name, asked in zip(self.world.names, edits.probes, strict=True):
            others = {role: _asking(getattr(services[name], role), where) for role, where in PROBES[asked].items()}
            services[name] = replace(services[name], **others)
        contents = {
            name: {f"services/{name}.conf": file}
            for name, file in zip(self.world.names, edits.files, strict=True)
            if name in self.world.files
        }
        manifests = repr((edits.editions, edits.probes, edits.always))
        desired = desire(replace(catalog, services=services, fingerprint=manifests), contents=contents)
        for name, edition in zip(self.world.names, edits.editions, strict=True):
            if edition in BAD:
                self.bad[desired.digests[name]] = {"bad": "exit", "refused": "start"}[edition]
        return desired


def _asking(probe: Probe | None, where: str) -> Probe | None:
    return probe and replace(probe, target=where)


def draw_features(chance: random.Random) -> tuple[int, tuple[Feature, ...]]:
    """Return a number of services, and features of them."""
    count = chance.choice((1, 2, 2, 3, 3, 3, 4, 4, MOST_SERVICES, MOST_SERVICES))
    pairs = [(str(a), str(b)) for a, b in itertools.combinations(range(count), 2)]
    needs = [("needs", b, a) for a, b in pairs if chance.random() < NEEDED]
    needed = [(b, a) for _, b, a in needs]
    probes = [("probe", str(n)) for n in range(count) if chance.random() < PROBED]
    slots: list[Feature] = [(name, str(n)) for name in MORE_SINGLE for n in range(count)]
    slots += [(name, *pair) for name in ("restart", *JOINS) for pair in needed for _ in range(3)]
    slots += [(name, a, b) for name in ("conflict", "gpu", "set") for a, b in pairs for _ in range(2)]
    slots += [(name, *chance.sample([*map(str, range(count))], 3)) for name in TRIPLE if count > 2 for _ in range(5)]
    return count, tuple(dict.fromkeys([*needs, *probes, *chance.sample(slots, chance.randint(0, MOST_FEATURES))]))


@lru_cache(maxsize=64)
def world_of(count: int, features: tuple[Feature, ...]) -> WalkWorld | None:
    """Return the world with these features; None if a service has two ways to idle, or joins twice."""
    ways = [f[1] for f in features if f[0] in IDLING] + [f"joins {f[1]}" for f in features if f[0] in JOINS]
    if len(ways) != len({*ways}):
        return None
    old = [f for f in features if f[0] not in MORE_SINGLE and f[0] not in (*JOINS, "set")]
    specs = specs_of(tuple(old), count)
    for name, first, *more in features:
        spec = specs[f"s{first}"]
        if name in MORE_SINGLE:
            _add(spec, MORE_SINGLE[name])
        elif name in JOINS:
            _add(spec, {"container": {name: f"service:s{more[0]}"}})
        elif name == "set":
            for one in (spec, specs[f"s{more[0]}"]):
                _add(one, {"update": {"atomic": True}})
    files = frozenset(f"s{f[1]}" for f in features if f[0] in FILES)
    return WalkWorld(specs, " ".join("".join(f) for f in features) or "plain", files)


def _add(spec: dict, more: Mapping) -> None:
    for key, value in more.items():
        merges = isinstance(value, Mapping) and key != "ready"  # a probe takes the place of a delay
        spec[key] = {**spec.get(key, {}), **value} if merges else value
