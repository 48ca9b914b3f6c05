"""The computers of a robot, the machine of each service, and what cannot cross machines."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from typing import Any

from rorg.manifest.anywhere import anywhere, check_placement
from rorg.manifest.documents import Source
from rorg.model.catalog import Service
from rorg.model.diagnostics import Diagnostic, Reading, Where, nearest, unknown
from rorg.model.engines import SWARM
from rorg.model.machines import ANYWHERE, PORT, Machine


def machines_of(sources: Mapping[str, Source]) -> Reading[dict[str, Machine]]:
    """Machines by name. Two with the same address or certificate, and two that are the default, are errors."""
    machines: dict[str, Machine] = {}
    for name, source in sources.items():
        spec: Any = source.spec
        address = spec.address if spec.address.rpartition(":")[2].isdecimal() else f"{spec.address}:{PORT}"
        where = source.where("metadata", "name")
        machine = Machine(name, address, spec.certificate or f"machine-{name}", spec.lease, spec.default, where)
        for other in machines.values():
            for what in ("address", "certificate"):
                if getattr(other, what) == getattr(machine, what):
                    message = f"the machine '{other.name}' has the same {what}"
                    yield Diagnostic(source.where("spec", what), message, f"another {what}")
            if other.default and machine.default:
                message = f"the machine '{other.name}' is the default, too"
                yield Diagnostic(source.where("spec", "default"), message, "to drop one of them")
        machines[name] = machine
    return machines


def machine_for(machines: Mapping[str, Machine], named: str, host: str, engine: str = "") -> str | Diagnostic:
    """The machine that this rorg is: the one that is named, else the one with its host name (`host`, with or without
    its domain); a Diagnostic if it is none of them. The machine `any`, and no other, has a Swarm as its `engine`."""
    found = next((name for name in ((named,) if named else (host, host.partition(".")[0])) if name in machines), "")
    if engine and (engine == SWARM) != (found == ANYWHERE):
        where = machines[found].where if found else Where("")
        remedy = f"`rorg run --machine {ANYWHERE} --engine {SWARM}` for it, and another engine for the others"
        return Diagnostic(where, f"the engine of {found or 'this robot'} cannot be '{engine}'", remedy)
    if found or not machines:
        return found
    which = f"there is no machine '{named}'" if named else f"this computer, {host}, is none of the machines"
    remedy = nearest(named, machines) if named else ""
    where = next(iter(machines.values())).where
    return Diagnostic(
        where, f"{which}: {', '.join(machines)}", remedy or "`rorg run --machine NAME`, or RORG_MACHINE=NAME"
    )


def belonging(
    services: Mapping[str, Service], sources: Mapping[str, Source], machines: Mapping[str, Machine], broken: set[str]
) -> Reading[dict[str, Service]]:
    """Services with their machines. A service that names an unknown machine, or none, is an error."""
    default = next((m.name for m in machines.values() if m.default), "")
    result = dict(services)
    for name, source in sources.items():
        service, machine = services[name], source.spec.machine or default
        if machine == ANYWHERE and ANYWHERE not in {*machines, *broken}:
            message = f"no Machine is called '{ANYWHERE}', whose rorg has the Swarm"
            remedy = f"a Machine with `metadata: {{name: {ANYWHERE}}}` and the address of that rorg"
            yield Diagnostic(source.where("spec", "machine"), message, remedy)
        elif machine and machine not in machines and machine not in broken:
            yield unknown(source.where("spec", "machine"), "machine", machine, machines)
        elif machines and not machine and not service.meta and not broken & set(machines):
            message = f"'{name}' does not say on which machine it runs"
            remedy = f"machine: {next(iter(machines))}, or `default: true` in a Machine"
            yield Diagnostic(source.where("metadata", "name"), message, remedy)
        if not service.meta:
            result[name] = replace(service, machine=machine)
            if machine == ANYWHERE and service.spec is not None:
                result[name] = anywhere(result[name], source)
            yield from check_placement(result[name], source)
    return result


def check_crossings(services: Mapping[str, Service], sources: Mapping[str, Source]) -> Iterator[Diagnostic]:
    """Relations that hold on one machine only."""
    sets: dict[str, Service] = {}
    for name, source in sources.items():
        service = services[name]
        first = sets.setdefault(service.update.atomic, service) if service.update.atomic else service
        if first.machine != service.machine:
            message = f"'{name}' changes together with '{first.name}', which runs on {first.machine}"
            yield Diagnostic(source.where("spec", "update", "atomic"), message, "sets of services of one machine")
        yield from _crossing(source, service, services, service.conflicts, "conflicts", "conflicts with")
        yield from _crossing(source, service, services, service.joins, "container", "is joined to the container of")


def _crossing(
    source: Source, service: Service, services: Mapping[str, Service], others: Collection[str], field: str, verb: str
) -> Iterator[Diagnostic]:
    for other in others:
        there = services[other].machine if other in services else service.machine
        if there != service.machine and not services[other].meta:
            message = f"'{service.name}' {verb} '{other}', which runs on {there}"
            yield Diagnostic(source.where("spec", field), message, "services of one machine")
