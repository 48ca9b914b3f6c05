"""A robot of stand-ins: each service of a tree runs a program that uses the CPU and memory that its manifest declares,
instead of its own."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

from rorg.model.catalog import Catalog, Image, Probe, Service, Updating

PROGRAM = "standin"
"""The program, and the image that contains it."""
MOST_CPU, MOST_MEMORY = 0.25, 0.25
"""Fractions of the machine that all stand-ins may take together by default, because other programs need it too."""
READY_AFTER = 0.1
"""Seconds until a stand-in counts as ready if its own program would have to answer the probe."""
TASK = 1.0
"""Seconds that a stand-in of a task runs."""
LOCAL = ("127.0.0.1", "localhost", "")


@dataclass(frozen=True, slots=True)
class Share:
    """Factors for declared cores and bytes, to scale them from another machine to this one."""

    cpu: float = 1.0
    memory: float = 1.0


def share_of(catalog: Catalog, names: Collection[str], cores: float, memory: float) -> Share:
    """The share with which these services together use at most MOST_CPU of the cores and MOST_MEMORY of the bytes."""
    cpu = sum(catalog.services[n].cpu for n in names)
    used = sum(catalog.services[n].memory for n in names)
    return Share(
        min(1.0, round(MOST_CPU * cores / cpu, 3)) if cpu else 1.0,
        min(1.0, round(MOST_MEMORY * memory / used, 3)) if used else 1.0,
    )


def stand_ins(catalog: Catalog, images: Mapping[str, Image], share: Share, prefix: str) -> Catalog:
    """The same robot with stand-ins. Its needs, conflicts, requests, idle policies, priorities and groups stay as they
    are.

    Containers get another image and names that start with `prefix`; they use no devices, files, networks or volumes of
    the robot. Delays and probes of a TCP port on this machine stay, and the stand-in answers them. All other probes
    become delays; of several probes, the first port counts. Nothing is connected in the ROS graph. Measures against
    pressure are off, because they depend on the machine, which is a different one here."""
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
    """The probe of a stand-in, and the variables that make the stand-in answer it."""
    if probe is None or probe.kind == "delay":
        return probe, {}
    if probe.completed:
        return probe, {"STANDIN_EXIT_AFTER": f"{TASK:g}"}
    for one in probe.questions:
        host, _, port = str(one.target).rpartition(":")
        if one.kind == "tcp" and host in LOCAL and port.isdecimal():
            return replace(one, timeout=probe.timeout), {"STANDIN_READY": f"tcp:{port}"}
    return Probe("delay", READY_AFTER, timeout=probe.timeout), {}
