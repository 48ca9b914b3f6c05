"""The services that run now, for the threads beside the loop: probes, figures of use, workers.

The loop hands its memory over after each pass, so that none of these needs the loop itself.
"""

from __future__ import annotations

from rorg.core.memory import Memory
from rorg.core.observed import Container
from rorg.core.pressure import pressed
from rorg.daemon.recorder import Recorder
from rorg.daemon.tree import Tree
from rorg.engines.observe import Observer
from rorg.engines.protocol import Engine
from rorg.host.cgroups import reclaim
from rorg.model.load import Load
from rorg.model.policy import Thresholds
from rorg.model.units import format_memory


class Running:
    """`memory` is that of the loop's last pass. Any thread may call the methods."""

    def __init__(self, tree: Tree, engine: Engine, observer: Observer, recorder: Recorder) -> None:
        self.tree, self.engine, self.observer, self.recorder = tree, engine, observer, recorder
        self.memory = Memory()

    def container_of(self, service: str) -> Container | None:
        return next(iter(self.observer.snapshot().by_service().get(service, [])), None)

    def limits(self) -> Thresholds | None:
        return self.tree.desired.catalog.policy.pressure

    def sample_every(self) -> float | None:
        """Seconds between two samples of this machine's load; None if the policy sets no limits, or if the engine is on
        another machine."""
        limits = self.limits()
        return limits.step if limits and self.engine.local else None

    def load_matters(self, load: Load) -> bool:
        """Whether a sample of the machine's load is worth a pass."""
        limits = self.limits()
        return limits is not None and bool(
            self.memory.pressure.engaged or pressed(limits, self.tree.desired.catalog.policy.budget, load)
        )

    def use(self) -> dict[str, tuple[float, int]]:
        """By service that is alive: CPU seconds since it began, and bytes, of all its containers together."""
        alive = [c for c in self.observer.snapshot().containers if c.alive]
        usage, totals = self.engine.usage(alive), dict[str, tuple[float, int]]()
        for container in alive:
            if container.id in usage:
                used, (cpu, memory) = usage[container.id], totals.get(container.service, (0.0, 0))
                totals[container.service] = cpu + used.cpu, memory + used.memory
        return totals

    def alive(self) -> list[tuple[Container, float | None]]:
        """Containers that have not ended, each with the time since when it runs, by the loop's clock; None while it
        is paused, or if that is not known yet."""
        containers = [(c, self.memory.of(c.service)) for c in self.observer.snapshot().containers if c.alive]
        runs = ((c, step, c.state == "running" and step.incarnation == c.incarnation) for c, step in containers)
        return [(c, step.running_since if known else None) for c, step, known in runs]

    def paused(self, name: str) -> None:
        """A service was just paused: push its memory out to swap, if its manifest says so."""
        service, container = self.tree.desired.catalog.services.get(name), self.container_of(name)
        if not (self.engine.capabilities.isolation and self.engine.local and service and service.idle.reclaim):
            return
        if not container or container.state != "paused":
            return
        try:
            freed = reclaim(container.pid)
        except OSError as error:
            self.recorder.event("reclaim-failed", f"memory of {name} stays: {error}", service=name)
        else:
            text = f"{format_memory(freed)} of {name} pushed out to swap"
            self.recorder.event("reclaimed", text, service=name, bytes=freed)
