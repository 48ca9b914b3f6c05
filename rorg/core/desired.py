"""The desired state, derived once per state of the manifests: digests, order, relations. Everything here would
otherwise be computed again in every pass."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from graphlib import TopologicalSorter
from typing import Any

from rorg.core.diff import declared_now
from rorg.core.digest import digest
from rorg.model.catalog import Catalog, Idle, Service
from rorg.model.devices import Device
from rorg.model.image_names import declared
from rorg.model.objects import EngineObject, keys_of
from rorg.model.probe import Probe
from rorg.model.run_directory import RUN


@dataclass(frozen=True, slots=True, kw_only=True)
class Desired:
    """A catalog together with what is derived from it."""

    catalog: Catalog
    digests: Mapping[str, str]
    editions: Mapping[str, str]
    """Service -> digest of everything that the trial of its next container depends on."""
    declared: Mapping[str, Mapping[str, Any]]
    """Service -> its options in the form of a container's label."""
    order: tuple[str, ...]
    """All services, each after everything it needs."""
    dependants: Mapping[str, tuple[str, ...]]
    conflicts: Mapping[str, tuple[str, ...]]
    """Service -> services it conflicts with, whichever side declared it."""
    sharers: Mapping[str, tuple[str, ...]]
    """Exclusive resource -> services that use it."""
    rivals: Mapping[str, frozenset[str]]
    """Service -> services whose plan depends on whether it is active although they do not need it: they conflict or
    share an exclusive resource."""
    sets: Mapping[str, tuple[str, ...]]
    """Name of an atomic set -> the services that change together."""
    interlocks: Mapping[str, Probe]
    """Service -> its interlock."""
    drivers: tuple[str, ...] = ()
    """Services that wait for devices."""
    devices: tuple[Device, ...] = ()
    """All devices of drivers."""
    objects: Mapping[str, EngineObject] = field(default_factory=dict)
    """Networks and volumes, by their subject in a plan."""
    uses: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Service -> subjects of the networks and volumes it uses."""
    users: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Subject -> services that use it."""
    keys: frozenset[str] = frozenset()
    """Keys under which networks and volumes are looked up on the engine."""
    contents: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """Service -> mounted path of the tree -> digest of its content, for services that care about changes."""
    ros: Mapping[str, str] = field(default_factory=dict)
    """Service -> digest of its ROS parameters."""


def desire(
    catalog: Catalog,
    run: str = "/run/rorg",
    contents: Mapping[str, Mapping[str, str]] | None = None,
    images: Mapping[str, str] | None = None,
) -> Desired:
    """Derive the desired state of a catalog. `run` is the directory of rorg's sockets. `images` maps an Image of the
    tree to the reference that stands for its content, so a container's digest changes with the content of its image.
    `contents` has the digests of the files that services mount from the tree, unless they read them when they like."""
    catalog = _from_sources(_located(catalog, run), images or {}, contents or {})
    contents = contents or {}
    services, nobody = catalog.services, dict.fromkeys(catalog.services, tuple[str, ...]())
    graph = {name: sorted(n for n in services[name].needs if n in services) for name in sorted(services)}
    pairs = [(n, rival) for n, s in services.items() for rival in s.conflicts if rival in services and rival != n]
    conflicts = nobody | _grouped(pair for a, b in pairs for pair in ((a, b), (b, a)))
    sharers = _grouped((resource, name) for name, s in services.items() for resource in s.exclusive)
    sets = _grouped((s.update.atomic, n) for n, s in sorted(services.items()) if s.update.atomic and not s.meta)
    objects, uses, users = used_objects(catalog)
    return Desired(
        catalog=catalog,
        objects=objects,
        uses=uses,
        users=users,
        keys=frozenset(one.key for one in objects.values()),
        digests={name: digest(s.spec) for name, s in services.items() if s.spec is not None},
        editions={name: _edition(s, contents.get(name)) for name, s in services.items() if s.spec is not None},
        declared={name: declared_now(s.spec, s.secrets) for name, s in services.items() if s.spec is not None},
        order=tuple(TopologicalSorter(graph).static_order()),
        dependants=nobody | _grouped((need, name) for name, needs in graph.items() for need in needs),
        conflicts=conflicts,
        sharers=sharers,
        rivals=_rivals(services, conflicts, sharers),
        # A single service has nothing to change together with.
        sets={name: members for name, members in sets.items() if len(members) > 1},
        interlocks={name: s.interlock for name, s in services.items() if s.interlock},
        drivers=tuple(sorted(name for name, s in services.items() if s.devices)),
        devices=tuple(sorted({d for s in services.values() for d in s.devices}, key=lambda d: d.text)),
        contents=contents,
        ros={n: digest({"master": s.ros.graph, "values": s.ros.values}) for n, s in services.items() if s.ros},
    )


def desire_again(catalog: Catalog, contents: Mapping[str, Mapping[str, str]]) -> Desired:
    """Derive the desired state of a catalog that another desired state led to. It keeps its fingerprint, which stands
    for what people wrote."""
    derived = desire(catalog, contents=contents)
    return replace(derived, catalog=replace(derived.catalog, fingerprint=catalog.fingerprint))


def _edition(service: Service, content: Mapping[str, str] | None) -> str:
    """Return the digest of everything that the trial of a service's next container depends on."""
    return digest({"spec": service.spec, **_probes(service), "content": content})


def _rivals(
    services: Mapping[str, Service], conflicts: Mapping[str, Sequence[str]], sharers: Mapping[str, Sequence[str]]
) -> dict[str, frozenset[str]]:
    """Return, for each service that has any, the services that cannot always run beside it. Sharers of a resource
    include the service itself."""
    return {
        name: frozenset(conflicts[name]).union(*(sharers[r] for r in s.exclusive))
        for name, s in services.items()
        if s.exclusive or conflicts[name]
    }


def _grouped(pairs: Iterable[tuple[str, str]]) -> dict[str, tuple[str, ...]]:
    """Return all values of each key, sorted."""
    groups: dict[str, set[str]] = {}
    for key, value in pairs:
        groups.setdefault(key, set()).add(value)
    return {key: tuple(sorted(values)) for key, values in groups.items()}


def _probes(service: Service) -> dict[str, Any]:
    """Return what defines readiness in an edition. The key `live` is left out if there is no such probe, so that
    editions written before `live` existed stay the same."""
    live = {"live": _edition_fields(service.live)} if service.live else {}
    return {"ready": service.ready and _edition_fields(service.ready), **live}


def _edition_fields(probe: Probe) -> dict[str, Any]:
    """Return the fields of a probe for an edition, in the form of earlier versions of rorg, so that services proven
    then need not be proven again: `graph` is called `master`, and `parts` is left out if empty."""
    named = {"master" if name == "graph" else name: value for name, value in _shallow(probe).items()}
    return {**named, "parts": [_all_fields(part) for part in probe.parts]} if probe.parts else named


def _all_fields(part: Probe) -> dict[str, Any]:
    return {**_edition_fields(part), "parts": ()}


def _shallow(probe: Probe) -> dict[str, Any]:
    return {f.name: getattr(probe, f.name) for f in fields(probe) if f.name != "parts"}


def _from_sources(catalog: Catalog, images: Mapping[str, str], mounted: Mapping[str, Mapping[str, str]]) -> Catalog:
    """Replace image names by references to the present content of these images. The fingerprint then covers everything
    that can change a container: manifests, images, and mounted files."""
    renamed = {
        name: replace(service, spec={**service.spec, "image": images[image]})
        for name, service in catalog.services.items()
        if service.spec is not None and (image := declared(service.spec.get("image", ""), images))
    }
    known = {name: replace(i, reference=images.get(name, i.reference)) for name, i in catalog.images.items()}
    return replace(
        catalog,
        services={**catalog.services, **renamed},
        images=known,
        fingerprint=_fingerprint(catalog.fingerprint, images, mounted),
    )


def _fingerprint(manifests: str, images: Mapping[str, str], mounted: Mapping[str, Mapping[str, str]]) -> str:
    """Return the fingerprint of the manifests, and of the images and mounted files if there are any."""
    sources: dict[str, Any] = {"images": sorted(images.values())} if images else {}
    if files := {path: content for of in mounted.values() for path, content in of.items()}:
        sources["files"] = files
    return digest({"manifests": manifests, **sources}).partition(":")[2][:16] if sources else manifests


def _located(catalog: Catalog, run: str) -> Catalog:
    """Insert the directory of rorg's sockets into containers that call rorg, or that read parameters from there."""
    services = {}
    for name, service in catalog.services.items():
        if (service.calls or (service.ros and service.domain is not None)) and service.spec is not None:
            located = {option: _with(value, run) for option, value in service.spec.items() if option in LOCATED}
            services[name] = replace(service, spec={**service.spec, **located})
    return replace(catalog, services={**catalog.services, **services}) if services else catalog


LOCATED = ("volumes", "environment", "command")
"""Options that may name the directory of rorg's sockets."""


def _with(value: Any, run: str) -> Any:
    if isinstance(value, Mapping):
        return {key: _with(item, run) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_with(item, run) for item in value]
    return value.replace(RUN, run) if isinstance(value, str) else value


Uses = Mapping[str, tuple[str, ...]]


def used_objects(catalog: Catalog) -> tuple[Mapping[str, EngineObject], Uses, Uses]:
    """Return declared networks and volumes by subject, the ones each service uses, and the services that use each one.
    Undeclared ones are left out: the engine has them or creates them itself."""
    objects = {item.subject: item for item in (*catalog.networks.values(), *catalog.volumes.values())}
    if not objects:
        return {}, {}, {}
    by_key = {item.key: name for name, item in objects.items()}
    uses: dict[str, tuple[str, ...]] = {}
    for name, service in catalog.services.items():
        if used := tuple(dict.fromkeys(by_key[key] for key in keys_of(service.options) if key in by_key)):
            uses[name] = used
    return objects, uses, _grouped((subject, name) for name, subjects in uses.items() for subject in subjects)


GONE = Idle(action="remove")


def teardown(desired: Desired, last: Catalog | None) -> Desired:
    """Return a desired state in which everything goes. If no tree could be read, the `last` good one gives the
    order."""
    catalog = desired.catalog if len(desired.catalog.services) > 1 else last or desired.catalog
    services = {
        name: service if service.meta else replace(service, always_on=False, idle=GONE)
        for name, service in catalog.services.items()
    }
    # `rorg down` is a person's order: nothing waits for another confirmation.
    policy = replace(catalog.policy, removals="auto")
    # No network is kept, and no volume if the person said so.
    fingerprint = desired.catalog.fingerprint
    gone = replace(
        catalog, services=services, networks={}, volumes={}, requests=(), policy=policy, fingerprint=fingerprint
    )
    return desire_again(gone, desired.contents)
