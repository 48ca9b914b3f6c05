"""The robots that recorded.py runs, each with its day of requests. Stand-ins take the place of all programs."""

from __future__ import annotations

import itertools
import random
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from rorg.tools.sim.generate import generate_day

ROOT = Path(__file__).parents[2]
STANDIN, BASE_IMAGE = ROOT / "images/standin/standin", "rorg-base"
SCALE = 0.4
"""Factor on the CPU and memory of the tour guide, so that all of it fits on two cores."""
FOLDERS = {"Service": "services", "Group": "groups", "Request": "requests", "Policy": "policies"}
PORT = 18100
"""The first port on which stand-ins answer."""


@dataclass(frozen=True)
class Ask:
    """A request, or its release if it names no services."""

    at: float
    """Seconds since the day began."""
    id: str
    services: tuple[str, ...] = ()
    by: str = "developer"
    ttl: str | None = None


@dataclass(frozen=True)
class Robot:
    """Manifests by kind and name, and a day."""

    services: Mapping[str, Mapping[str, Any]]
    day: Sequence[Ask]
    seconds: float
    kinds: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def write(self, folder: Path) -> Path:
        """Writes the manifests."""
        for kind, specs in {"Service": self.services, **self.kinds}.items():
            for name, spec in specs.items():
                document = {"apiVersion": "rorg/v1", "kind": kind, "metadata": {"name": name}, "spec": spec}
                path = folder / FOLDERS[kind] / f"{name}.yaml"
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
        return folder


def stand_in(cpu: float, memory: float, environment: Mapping[str, str] | None = None, **spec: Any) -> dict[str, Any]:
    """The spec of a service whose program is a stand-in. `memory`: MiB."""
    uses = {"STANDIN_CPU": f"{cpu:g}", "STANDIN_MEMORY": f"{round(memory * (1 << 20))}"}
    container = {
        "network_mode": "host",
        "init": True,
        "volumes": [f"{STANDIN}:/standin:ro"],
        "environment": {**uses, **(environment or {})},
    }
    return {
        **spec,
        "image": BASE_IMAGE,
        "command": ["python3", "-S", "/standin"],
        "resources": {"cpu": cpu, "memory": f"{round(memory * 1024)}Ki"},
        "container": {**container, **spec.get("container", {})},
    }


_ports = itertools.count(PORT)


def probed(
    cpu: float, memory: float, start: float, stop: float = 0.0, load: float = 0.0, **spec: Any
) -> dict[str, Any]:
    """The same, ready when its port answers. `start`: seconds until then; `stop`: until it ends; `load`: CPU seconds
    that it works before it is ready."""
    port, times = (
        next(_ports),
        {"STANDIN_START": f"{start:g}", "STANDIN_STOP": f"{stop:g}", "STANDIN_START_CPU": f"{load:g}"},
    )
    return stand_in(cpu, memory, {**times, "STANDIN_READY": f"tcp:{port}"}, **{"ready": {"tcp": port}, **spec})


def tour_guide() -> Robot:
    """The robot of manifests/, smaller, and a day of twenty minutes in two and a half."""
    keep = ("needs", "idle", "ready", "priority", "always_on", "conflicts", "exclusive", "restarts_with")
    services = {}
    for path in sorted((ROOT / "manifests/services").glob("*.yaml")):
        spec = yaml.safe_load(path.read_text(encoding="utf-8"))["spec"]
        use, ready = spec["resources"], spec.get("ready", {}).get("tcp")
        answers = {"STANDIN_READY": f"tcp:{ready}"} if ready else {}
        kept = {word: spec[word] for word in keep if word in spec}
        services[path.stem] = stand_in(
            round(use["cpu"] * SCALE, 4), float(use["memory"].removesuffix("Mi")) * SCALE, answers, **kept
        )
    day = generate_day(1200, 12, 2, seed=1).compressed(8)
    asks = [Ask(e.at, e.id, e.services, e.requester) for e in day.events]
    return Robot(services, asks, day.duration, {kind: _specs(kind) for kind in FOLDERS if kind != "Service"})


def _specs(kind: str) -> dict[str, Any]:
    documents = (
        yaml.safe_load(path.read_text()) for path in sorted((ROOT / "manifests" / FOLDERS[kind]).glob("*.yaml"))
    )
    return {one["metadata"]["name"]: one["spec"] for one in documents}


def ros_robot() -> Robot:
    """Ten services with probes, needs, pauses and stops."""
    pause, stop = ({"action": action, "linger": "1s"} for action in ("pause", "stop"))
    services = {
        "roscore": probed(0.02, 30, 0.3, always_on=True),
        "wheels": probed(0.1, 25, 0.5, always_on=True, needs=["roscore"]),
        "laser": probed(0.08, 20, 0.4, needs=["roscore"], idle=pause),
        "camera": probed(0.15, 40, 0.6, needs=["roscore"], idle=pause),
        "localization": probed(0.2, 60, 1.5, 0.3, needs=["wheels", "laser"], idle=stop),
        "navigation": probed(0.15, 50, 0.8, 0.2, needs=["localization"], idle={"action": "pause", "linger": "2s"}),
        "detection": probed(0.3, 80, 1.2, 0.1, needs=["camera"], idle=stop),
        "tracking": probed(0.1, 30, 0.4, needs=["detection"], idle={"action": "stop", "linger": "0s"}),
        "speech": stand_in(0.05, 40, idle=pause),
        "dialogue": stand_in(0.08, 30, ready={"delay": "300ms"}, needs=["speech"], idle=stop),
    }
    tasks = {"drive": ("navigation",), "follow": ("tracking",), "talk": ("dialogue",)}
    return Robot(services, alternating(tasks, 150.0, seed=2), 150.0)


def alternating(tasks: Mapping[str, tuple[str, ...]], seconds: float, seed: int) -> list[Ask]:
    """Each task is requested and released in turns, each for five to twelve seconds."""
    rng, asks = random.Random(seed), list[Ask]()
    for id, services in tasks.items():
        at = rng.uniform(3, 12)
        while at < seconds - 12:
            until = at + rng.uniform(5, 12)
            asks += [Ask(round(at, 3), id, services), Ask(round(until, 3), id)]
            at = until + rng.uniform(5, 12)
    return sorted(asks, key=lambda one: one.at)


def crowded_robot() -> Robot:
    """Exclusive resources, conflicts, groups and leases."""
    stop = {"action": "stop", "linger": "0s"}
    services = {
        "base": probed(0.05, 30, 0.3, always_on=True),
        "behaviour": stand_in(0.03, 30, always_on=True),
        "camera": probed(0.15, 40, 0.5, needs=["base"], idle={"action": "pause", "linger": "1s"}),
        "detection": probed(0.3, 60, 0.9, 0.1, needs=["camera"], exclusive=["gpu"], priority=40, idle=stop),
        "segmentation": probed(0.4, 70, 1.1, 0.1, needs=["camera"], exclusive=["gpu"], priority=60, idle=stop),
        "mapping": probed(0.2, 50, 0.7, conflicts=["localization"], priority=30, idle=stop),
        "localization": probed(0.15, 50, 1.0, 0.2, needs=["base"], priority=60, idle=stop),
        "wheels": probed(0.1, 20, 0.4, needs=["base"], idle={"action": "pause", "linger": "500ms"}),
        "microphone": stand_in(0.05, 20, idle={"action": "pause", "linger": "0s"}),
        "recognition": probed(0.2, 60, 0.8, needs=["microphone"], idle=stop),
    }
    groups = {"driving": {"services": ["localization", "wheels"]}, "looking": {"services": ["camera", "detection"]}}
    asks = list(alternating({"look": ("looking",), "drive": ("driving",)}, 150.0, seed=3))
    for number in range(9):  # shorter than the pauses of `look` and `drive`, and begun at any time in them
        at = 8.0 + 15 * number
        asks.append(Ask(at, "segment", ("segmentation",), ttl="4s"))
        asks.append(Ask(at + 3, "map", ("mapping",), ttl="5s"))
    for number in range(14):
        at = 5.0 + 10 * number
        asks += [Ask(at, "behaviour", ("recognition",), "behaviour"), Ask(at + 4, "behaviour", ("base",), "behaviour")]
    policy = {"default": {"resources": {"gpu": 1}}}
    return Robot(services, sorted(asks, key=lambda one: one.at), 150.0, {"Group": groups, "Policy": policy})


LOADERS = {"small": 1.0, "large": 3.0}
"""Service -> CPU seconds that it works until it is ready."""
BURNERS = (1024, 1024, 1024, 2048, 512, 512)
"""cpu_shares of services that burn a core each; the first half, and all, can be divided evenly among two cores."""


def busy_robot(demand: float, seconds: float = 60.0) -> Robot:
    """Burners that together want `demand` cores, and loaders that are requested again and again meanwhile."""
    stop = {"action": "stop", "linger": "0s"}
    shares = itertools.islice(itertools.cycle(BURNERS), round(demand))
    services = {f"burner{n}": stand_in(1.0, 20, idle=stop, container={"cpu_shares": s}) for n, s in enumerate(shares)}
    asks = [Ask(2.0, "burn", tuple(services))] if services else []
    for name, begin, every in (("small", 6.0, 9.0), ("large", 10.0, 16.0)):
        load = probed(0.05, 20, 0.0, load=LOADERS[name], idle=stop)
        services[name] = {**load, "ready": {**load["ready"], "interval": "50ms"}}
        for at in _times(begin, every, seconds - every):
            asks += [Ask(at, name, (name,)), Ask(at + every - 2.0, name)]
    return Robot(services, sorted(asks, key=lambda one: one.at), seconds)


def _times(begin: float, every: float, end: float) -> Iterable[float]:
    while begin < end:
        yield begin
        begin += every


ROBOTS = {"tour guide": tour_guide, "ROS-like": ros_robot, "crowded": crowded_robot}
