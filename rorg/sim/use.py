"""What all services use of the machine, added up exactly from change to change, and looked at now and then."""

from __future__ import annotations

from dataclasses import dataclass

from rorg.sim.results import Sample


@dataclass(frozen=True, slots=True)
class Use:
    """Of one container, from `since` on."""

    service: str
    doing: tuple[str, bool, str]
    """The state of its container, whether it is in use, and when this run began: another value, another use."""
    cores: float
    memory: float
    """Bytes at `since`, beside what it has grown by."""
    grew: float
    """Bytes that it has grown by until `since`."""
    growth: float
    """Bytes per second."""
    since: float

    @property
    def running(self) -> bool:
        return self.doing[0] == "running"

    def grown(self, now: float) -> float:
        """Bytes until now."""
        return self.grew + self.growth * (now - self.since)

    def memory_at(self, now: float) -> float:
        return self.memory + self.grown(now)


class MachineUse:
    """The sum over containers. `samples` are taken every `every` seconds, and at the end."""

    def __init__(self, every: float) -> None:
        self.every, self.now = every, 0.0
        self.cpu_seconds, self.byte_seconds = 0.0, 0.0
        self.samples: list[Sample] = []
        self._uses: dict[str, Use] = {}
        self._cores = self._memory = self._growth = 0.0
        """Sums of now; memory at `_since`."""
        self._since, self._stale = 0.0, False
        self._active, self._paused = frozenset[str](), frozenset[str]()
        self._sampled = 0.0, 0.0
        """When the last sample was, and the CPU seconds then."""

    @property
    def cores(self) -> float:
        """That are used now."""
        if self._stale:
            self._sum()
        return self._cores

    @property
    def memory(self) -> float:
        """Bytes, now."""
        if self._stale:
            self._sum()
        return self._memory + self._growth * (self.now - self._since)

    def by_service(self) -> dict[str, tuple[float, int]]:
        """Cores and bytes, now."""
        return {use.service: (use.cores, int(use.memory_at(self.now))) for use in self._uses.values()}

    def of(self, container: str) -> Use | None:
        return self._uses.get(container)

    def change(self, container: str, use: Use | None) -> None:
        """From now on a container uses this; None where it is over."""
        if use is None:
            self._uses.pop(container, None)
        else:
            self._uses[container] = use
        self._stale = True

    def _sum(self) -> None:
        """After changes, all of which are of now."""
        uses = self._uses.values()
        self._since, self._cores = self.now, sum([u.cores for u in uses])
        self._memory, self._growth = sum([u.memory_at(self.now) for u in uses]), sum([u.growth for u in uses])
        self._active = frozenset([u.service for u in uses if u.running])
        self._paused = frozenset([u.service for u in uses if not u.running]) - self._active
        self._stale = False

    def advance(self, now: float) -> None:
        """Time goes on to `now`, with a sample whenever one is due."""
        while (due := (len(self.samples) + 1) * self.every) <= now:
            self._add(due)
            self.sample()
        self._add(now)

    def _add(self, now: float) -> None:
        for_seconds = now - self.now
        before, cores = self.memory, self.cores
        self.cpu_seconds += cores * for_seconds
        self.now = now
        self.byte_seconds += (before + self.memory) / 2 * for_seconds

    def sample(self) -> None:
        """How it is now; nothing where a sample has just been taken."""
        at, seconds = self._sampled
        if self.now > at:
            mean = (self.cpu_seconds - seconds) / (self.now - at)
            self.samples.append(Sample(self.now, mean, round(self.memory), self._active, self._paused))
            self._sampled = self.now, self.cpu_seconds
