"""What a running rorg uses, from time to time, and the slope of it."""

from __future__ import annotations

import itertools
import math
import re
import statistics
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from soak import SoakedRorg


@dataclass(frozen=True)
class Sample:
    at: float
    """Minutes since the start."""
    memory: float
    """PSS in MB."""
    heap: float
    """Anonymous memory in MB."""
    blocks: int
    """That the interpreter has allocated."""
    descriptors: int
    threads: int
    latency: float
    """Median of nine questions about one service, in ms."""
    engine: int
    """Connections that the engine has, with one of the test."""
    state: float
    """The state directory in MB."""
    journal: float
    """Of that the history, with its log, in MB."""


def sample(rorg: SoakedRorg, began: float) -> Sample:
    rollup = Path(f"/proc/{rorg.process.pid}/smaps_rollup").read_text()
    memory, heap = (int(re.search(rf"^{n}:\s+(\d+)", rollup, re.MULTILINE)[1]) / 1024 for n in ("Pss", "Anonymous"))
    path = rorg.host.removeprefix("unix://")
    unix = [line.split() for line in Path("/proc/net/unix").read_text().splitlines()]
    state = rorg.robot.state
    return Sample(
        at=(time.monotonic() - began) / 60,
        memory=memory,
        heap=heap,
        blocks=rorg.ask("blocks"),
        descriptors=rorg.seen.num_fds(),
        threads=rorg.seen.num_threads(),
        latency=latency(rorg),
        engine=sum(words[-1] == path and words[5] == "03" for words in unix),
        state=size(state.path.rglob("*")),
        journal=size(state.path.glob(f"{state.journal.name}*")),
    )


def latency(rorg: SoakedRorg) -> float:
    def one() -> float:
        began = time.perf_counter()
        rorg.client.service("clock")
        return 1000 * (time.perf_counter() - began)

    return statistics.median(one() for _ in range(9))


def size(files: Iterable[Path]) -> float:
    """MB."""
    found = 0
    for file in files:
        try:
            found += file.lstat().st_size
        except FileNotFoundError:
            continue
    return found / (1 << 20)


@dataclass(frozen=True)
class Slope:
    """Of a straight line through samples, by least squares, a minute."""

    slope: float
    error: float
    """Standard error, with neighbouring samples counted for less the more alike they are."""

    def __str__(self) -> str:
        return f"{self.slope:+.4f} ± {self.error:.4f} a minute"

    def above(self, bound: float) -> bool:
        """Significantly: by two standard errors."""
        return self.slope - 2 * self.error > bound


def slope(samples: Sequence[tuple[float, float]]) -> Slope:
    count = len(samples)
    mean_x, mean_y = (sum(values) / count for values in zip(*samples, strict=True))
    spread = sum((x - mean_x) ** 2 for x, _ in samples)
    found = sum((x - mean_x) * (y - mean_y) for x, y in samples) / spread
    rest = [y - mean_y - found * (x - mean_x) for x, y in samples]
    squares = sum(r * r for r in rest)
    alike = sum(one * after for one, after in itertools.pairwise(rest)) / squares if squares > 1e-12 else 0.0
    alike = min(max(alike, 0.0), 0.98)
    return Slope(found, math.sqrt(squares / (count - 2) / spread * (1 + alike) / (1 - alike)))
