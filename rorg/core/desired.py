"""What is desired, computed once for a catalog."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from graphlib import TopologicalSorter
from typing import Any

from rorg.core.diff import declared_now
from rorg.core.digest import digest
from rorg.core.uses import used_objects
from rorg.model.catalog import RUN, Catalog, Probe, Service
from rorg.model.devices import Device
from rorg.model.image_names import declared
from rorg.model.objects import EngineObject


@dataclass(frozen=True, slots=True, kw_only=True)
class Desired:
    """The catalog with what is worth computing once for it."""

    catalog: Catalog
    digests: Mapping[str, str]
    editions: Mapping[str, str]
    """Service -> all that the trial of a new container of it depends on."""
    declared: Mapping[str, Mapping[str, Any]]
    """Service -> its options as a container's record has them."""
    order: tuple[str, ...]
    """All services, what is needed before what needs it."""
    dependants: Mapping[str, tuple[str, ...]]
    conflicts: Mapping[str, tuple[str, ...]]
    """In both directions, whichever side declared them."""
    sharers: Mapping[str, tuple[str, ...]]
    """Exclusive resource -> the services that use it."""
    rivals: Mapping[str, frozenset[str]]
    """Service -> those whose plan depends on whether it is active, though they do not need it: it conflicts with them,
    or shares an exclusive resource with them."""
    sets: Mapping[str, tuple[str, ...]]
    """Set -> the services that change together."""
    interlocks: Mapping[str, Probe]
    """Of the services that have one."""
    drivers: tuple[str, ...] = ()
    """Services that wait for devices."""
    devices: tuple[Device, ...] = ()
    """All of these."""
    objects: Mapping[str, EngineObject] = field(default_factory=dict)
    """Networks and volumes, by their subject in a plan."""
    uses: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Service -> the subjects of those that it uses."""
    users: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Subject -> the services that use it."""
    keys: frozenset[str] = frozenset()
    """By which these are looked for on the engine."""
    contents: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """Service -> what it mounts from the tree -> digest of what is there, where it cares."""
    ros: Mapping[str, str] = field(default_factory=dict)
    """Service -> digest of the ROS parameters that it declares."""


def desire(
    catalog: Catalog,
    run: str = "/run/rorg",
    contents: Mapping[str, Mapping[str, str]] | None = None,
    images: Mapping[str, str] | None = None,
) -> Desired:
    """Digests and orders of a catalog. `run` is the directory of rorg's sockets; `images`: Image of the tree -> the
    reference that means its content. So the digest of a service's container changes with the content of its image."""
    contents = contents or {}
    catalog = _from_images(_located(catalog, run), images or {})
    services = catalog.services
    graph, dependants, conflicts, sharers = _relations(services)
    objects, uses, users = used_objects(catalog)
    return Desired(
        catalog=catalog,
        objects=objects,
        uses=uses,
        users=users,
        keys=frozenset(one.key for one in objects.values()),
        digests={name: digest(s.spec) for name, s in services.items() if s.spec is not None},
        editions={
            name: digest({"spec": s.spec, **_probes(s), "content": contents.get(name)})
            for name, s in services.items()
            if s.spec is not None
        },
        declared={name: declared_now(s.spec, s.secrets) for name, s in services.items() if s.spec is not None},
        order=tuple(TopologicalSorter(graph).static_order()),
        dependants={name: tuple(sorted(found)) for name, found in dependants.items()},
        conflicts={name: tuple(sorted(found)) for name, found in conflicts.items()},
        sharers={resource: tuple(sorted(found)) for resource, found in sharers.items()},
        rivals={
            name: frozenset(conflicts[name].union(*(sharers[r] for r in s.exclusive)))
            for name, s in services.items()
            if s.exclusive or conflicts[name]
        },
        sets=_sets(services),
        interlocks={name: s.interlock for name, s in services.items() if s.interlock},
        drivers=tuple(sorted(name for name, s in services.items() if s.devices)),
        devices=tuple(sorted({d for s in services.values() for d in s.devices}, key=lambda d: d.text)),
        contents=contents,
        ros={name: digest(asdict(s.ros)) for name, s in services.items() if s.ros},
    )


def _probes(service: Service) -> dict[str, Any]:
    """What tells how a service is. Without `live` it is as it was before that counted, for the same reason as below."""
    live = {"live": _said(service.live)} if service.live else {}
    return {"ready": service.ready and _said(service.ready), **live}


def _said(probe: Probe) -> dict[str, Any]:
    """A probe of one question, as it was before there were parts: what ran well then is not to be proven again."""
    return {name: value for name, value in asdict(probe).items() if name != "parts" or value}


def _relations(
    services: Mapping[str, Service],
) -> tuple[dict[str, list[str]], dict[str, list[str]], dict[str, set[str]], dict[str, list[str]]]:
    """What each needs; who needs each; who conflicts with each; who uses each exclusive resource."""
    graph = {name: sorted(n for n in services[name].needs if n in services) for name in sorted(services)}
    dependants: dict[str, list[str]] = {name: [] for name in services}
    conflicts: dict[str, set[str]] = {name: set() for name in services}
    sharers: dict[str, list[str]] = {}
    for name, service in services.items():
        for need in graph[name]:
            dependants[need].append(name)
        for resource in service.exclusive:
            sharers.setdefault(resource, []).append(name)
        for other in service.conflicts:
            if other in services and other != name:
                conflicts[name].add(other)
                conflicts[other].add(name)
    return graph, dependants, conflicts, sharers


def _sets(services: Mapping[str, Service]) -> dict[str, tuple[str, ...]]:
    """Who goes together; whoever would be alone does not."""
    found: dict[str, list[str]] = {}
    for name, service in sorted(services.items()):
        if service.update.atomic and not service.meta:
            found.setdefault(service.update.atomic, []).append(name)
    return {name: tuple(members) for name, members in found.items() if len(members) > 1}


def _from_images(catalog: Catalog, images: Mapping[str, str]) -> Catalog:
    """With services made from what images contain, rather than from what they are called."""
    found = {
        name: replace(service, spec={**service.spec, "image": images[image]})
        for name, service in catalog.services.items()
        if service.spec is not None and (image := declared(service.spec.get("image", ""), images))
    }
    said = digest({"manifests": catalog.fingerprint, "images": sorted(images.values())})
    fingerprint = said.partition(":")[2][:16] if images else catalog.fingerprint
    known = {name: replace(i, reference=images.get(name, i.reference)) for name, i in catalog.images.items()}
    return replace(catalog, services={**catalog.services, **found}, images=known, fingerprint=fingerprint)


def _located(catalog: Catalog, run: str) -> Catalog:
    """With the sockets' directory in the containers that get one."""
    found = {}
    for name, service in catalog.services.items():
        if service.calls and service.spec is not None:
            spec = {
                **service.spec,
                "volumes": [v.replace(RUN, run) if isinstance(v, str) else v for v in service.spec["volumes"]],
            }
            spec["environment"] = {k: v.replace(RUN, run) for k, v in service.spec["environment"].items()}
            found[name] = replace(service, spec=spec)
    return replace(catalog, services={**catalog.services, **found}) if found else catalog
