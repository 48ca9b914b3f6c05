"""What the containers of a simulated machine use, added up over time."""

from __future__ import annotations

from dataclasses import dataclass

from rorg.core.steps import DEFAULT_SHARES
from rorg.tools.sim.contention import Demand, Shortage, granted
from rorg.tools.sim.results import Sample


@dataclass(frozen=True, slots=True)
class Use:
    """What one container uses, starting at `since`."""

    service: str
    doing: tuple[str, bool, str, bool]
    """Its state, whether it is in use, when this run began, and whether it still comes up: if one of them changes, so
    does its use."""
    cores: float
    """Cores that it wants; it gets fewer while the CPU is short."""
    memory: float
    """Bytes at `since`, without what it has grown by."""
    grew: float
    """Bytes that it had grown by at `since`."""
    growth: float
    """Bytes per second."""
    since: float
    shares: float = DEFAULT_SHARES
    """Its weight while the CPU is short."""

    @property
    def running(self) -> bool:
        return self.doing[0] == "running"

    def grown(self, now: float) -> float:
        """Bytes that it has grown by until now."""
        return self.grew + self.growth * (now - self.since)

    def memory_at(self, now: float) -> float:
        return self.memory + self.grown(now)


class MachineUse:
    """The sum over all containers. Samples are taken every `every` seconds, and at the end. `limit`: cores of the
    machine; None: there are always enough."""

    def __init__(self, every: float, limit: float | None = None) -> None:
        self.every, self.limit, self.now = every, limit, 0.0
        self.shortage = Shortage()
        self.cpu_seconds, self.byte_seconds = 0.0, 0.0
        self.samples: list[Sample] = []
        self._uses: dict[str, Use] = {}
        self._cores = self._wanted = self._memory = self._growth = 0.0
        """Current sums, with the memory as of `_since`."""
        self._granted: dict[str, float] = {}
        """Container -> the cores that it gets, with a limit."""
        self._since, self._stale = 0.0, False
        self._active, self._paused = frozenset[str](), frozenset[str]()
        self._sampled = 0.0, 0.0
        """Time of the last sample, and the CPU seconds at that time."""

    @property
    def cores(self) -> float:
        """Cores in use now."""
        if self._stale:
            self._sum()
        return self._cores

    @property
    def memory(self) -> float:
        """Bytes in use now."""
        if self._stale:
            self._sum()
        return self._memory + self._growth * (self.now - self._since)

    def by_service(self) -> dict[str, tuple[float, int]]:
        """Service -> cores and bytes in use now."""
        speeds = self.speeds()
        return {
            use.service: (use.cores * speeds.get(id, 1.0), int(use.memory_at(self.now)))
            for id, use in self._uses.items()
        }

    def speeds(self) -> dict[str, float]:
        """Running container -> the part of the CPU that it wants, and gets; empty without a limit."""
        if self._stale:
            self._sum()
        return {id: got / self._uses[id].cores for id, got in self._granted.items() if self._uses[id].cores}

    def of(self, container: str) -> Use | None:
        return self._uses.get(container)

    def change(self, container: str, use: Use | None) -> None:
        """Sets what a container uses from now on; None if it has ended."""
        if use is None:
            self._uses.pop(container, None)
        else:
            self._uses[container] = use
        self._stale = True

    def _sum(self) -> None:
        """Updates the sums after changes at the current time."""
        uses = self._uses.values()
        self._since, self._cores = self.now, sum([u.cores for u in uses])
        self._wanted = self._cores
        if self.limit is not None:
            demands = {id: Demand(u.cores, u.shares) for id, u in self._uses.items() if u.running}
            self._granted = granted(demands, self.limit)
            self._cores = sum(self._granted.values())
        self._memory, self._growth = sum([u.memory_at(self.now) for u in uses]), sum([u.growth for u in uses])
        self._active = frozenset([u.service for u in uses if u.running])
        self._paused = frozenset([u.service for u in uses if not u.running]) - self._active
        self._stale = False

    def advance(self, now: float) -> None:
        """Moves the time forward, and takes the samples that are due."""
        while (due := (len(self.samples) + 1) * self.every) <= now:
            self._add(due)
            self.sample()
        self._add(now)

    def _add(self, now: float) -> None:
        for_seconds = now - self.now
        before, cores = self.memory, self.cores
        self.cpu_seconds += cores * for_seconds
        self.shortage.add(for_seconds, self._wanted, cores)
        self.now = now
        self.byte_seconds += (before + self.memory) / 2 * for_seconds

    def sample(self) -> None:
        """Takes a sample, unless there is one of this moment already."""
        at, seconds = self._sampled
        if self.now > at:
            mean = (self.cpu_seconds - seconds) / (self.now - at)
            self.samples.append(Sample(self.now, mean, round(self.memory), self._active, self._paused))
            self._sampled = self.now, self.cpu_seconds
