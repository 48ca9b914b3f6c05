"""A robot of stand-ins: the services of a tree, each with a program in place of its own that uses the CPU and memory
that its manifest expects."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

from rorg.model.catalog import Catalog, Image, Probe, Service, Updating

PROGRAM = "standin"
"""The program, and the image that holds it."""
MOST_CPU, MOST_MEMORY = 0.25, 0.25
"""What all of them together take of the machine at the most, where nothing else is said: others use it too."""
READY_AFTER = 0.1
"""Seconds after which a stand-in counts as ready whose program would be asked something that only it can answer."""
TASK = 1.0
"""Seconds that a stand-in of a task runs."""
LOCAL = ("127.0.0.1", "localhost", "")


@dataclass(frozen=True, slots=True)
class Share:
    """Factors on what services declare: the cores and bytes of another machine become those of this one."""

    cpu: float = 1.0
    memory: float = 1.0


def share_of(catalog: Catalog, names: Collection[str], cores: float, memory: float) -> Share:
    """Such that these services together take MOST_CPU of the cores and MOST_MEMORY of the bytes at the most."""
    cpu = sum(catalog.services[n].cpu for n in names)
    used = sum(catalog.services[n].memory for n in names)
    return Share(
        min(1.0, round(MOST_CPU * cores / cpu, 3)) if cpu else 1.0,
        min(1.0, round(MOST_MEMORY * memory / used, 3)) if used else 1.0,
    )


def stand_ins(catalog: Catalog, images: Mapping[str, Image], share: Share, prefix: str) -> Catalog:
    """The same robot: who needs, excludes and requests whom, idle policies, priorities and groups are as they were.
    Containers get another image, and names that begin with `prefix`, and use no devices, files, networks or volumes of
    the robot. A probe of a TCP port of this machine stays, and the stand-in answers it; so does a delay; any other one
    becomes a delay, and of several the first port counts. No node is connected in the ROS graph. Measures against
    pressure are off: they go by the machine, which is another one here."""
    services = {name: _stand_in(one, share, prefix) if one.spec else one for name, one in catalog.services.items()}
    policy = replace(catalog.policy, pressure=None)
    return replace(catalog, services=services, images=images, networks={}, volumes={}, policy=policy)


def _stand_in(service: Service, share: Share, prefix: str) -> Service:
    ready, answers = _ready(service.ready)
    environment = {
        "RORG_SERVICE": service.name,
        "STANDIN_CPU": f"{service.cpu * share.cpu:.4f}",
        "STANDIN_MEMORY": f"{service.memory * share.memory:.0f}",
        **answers,
    }
    return Service(
        service.name,
        always_on=service.always_on,
        needs=service.needs,
        restarts_with=service.restarts_with,
        conflicts=service.conflicts,
        exclusive=service.exclusive,
        idle=replace(service.idle, reclaim=False, connected="pause"),
        update=Updating(),
        ready=ready,
        protected=service.protected,
        restart=service.restart,
        on_change="none",
        priority=service.priority,
        cpu=service.cpu * share.cpu,
        memory=round(service.memory * share.memory),
        spec={
            "container_name": f"{prefix}{service.name}",
            "image": PROGRAM,
            "entrypoint": [PROGRAM],
            "environment": environment,
            "init": True,
            "network_mode": "host",
            "stop_signal": "SIGTERM",
        },
        description=service.description,
        where=service.where,
    )


def _ready(probe: Probe | None) -> tuple[Probe | None, dict[str, str]]:
    """The probe of the stand-in, and what tells the stand-in to answer it."""
    if probe is None or probe.kind == "delay":
        return probe, {}
    if probe.completed:
        return probe, {"STANDIN_EXIT_AFTER": f"{TASK:g}"}
    for one in probe.questions:
        host, _, port = str(one.target).rpartition(":")
        if one.kind == "tcp" and host in LOCAL and port.isdecimal():
            return replace(one, timeout=probe.timeout), {"STANDIN_READY": f"tcp:{port}"}
    return Probe("delay", READY_AFTER, timeout=probe.timeout), {}
