"""Many cases from one seed. `make test` tries a few of each kind; `make fuzz` all of them (FUZZ=1; FUZZ=0.1 a tenth).
A case depends on its kind, its seed and its number alone: FUZZ_CASE=N tries that one again, FUZZ_SEED=N other ones."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

FULL = {
    "manifests": 20_000,
    "requests": 5_000,
    "bodies": 3_000,
    "streams": 2_000,
    "state": 500,
    "labels": 1_000,
    "answers": 100_000,
    "commits": 50,
    "archives": 2_000,
    "launches": 2_000,
    "launches2": 2_000,
    "units": 2_000,
    "dockerfiles": 2_000,
    "variables": 2_000,
    "projects": 2_000,
    "kills": 40,
}
"""Cases of each kind in a whole run."""
SHARE = float(os.environ.get("FUZZ") or 0)
SEED = os.environ.get("FUZZ_SEED") or "1"
ONLY = os.environ.get("FUZZ_CASE")
SLOWEST = 1.0 if SHARE else 5.0
"""Seconds for one case on the clock, so many times more as programs wait for a processor; with fewer cases, which run
beside other tests and on any machine, only what hangs is found."""
HUNG = 60
"""Seconds after which a case is ended, however busy the machine is."""
BOUNDED = {"archives", "launches", "launches2", "units", "dockerfiles", "variables", "projects"}
"""Kinds of what strangers write, of which no case may take more than this:"""
MOST_CPU, MOST_MEMORY = 2.0, 200.0
"""Seconds of a processor, and MiB above what the process had before."""
TRIES = 3
"""A case that is slow so often is slow by itself; a busy machine makes others slow."""
MOST = 10
"""Findings after which a run is over."""
KEPT = Path(tempfile.gettempdir(), "rorg-fuzz")
"""Where cases that found something are kept."""


@dataclass
class Case:
    """One try. Whoever makes it says what is tried in `text`, which is kept where it finds something."""

    kind: str
    number: int
    chance: random.Random
    text: str | bytes = ""

    @classmethod
    def of(cls, kind: str, number: int) -> Case:
        return cls(kind, number, random.Random(f"{kind} {SEED} {number}"))

    def keep(self, why: str) -> str:
        """What was found, and how it is found again."""
        KEPT.mkdir(exist_ok=True)
        path = KEPT / f"{self.kind}-{SEED}-{self.number}"
        path.write_bytes(self.text if isinstance(self.text, bytes) else self.text.encode(errors="surrogatepass"))
        return f"{self.kind}: FUZZ_SEED={SEED} FUZZ_CASE={self.number}: {why} (kept as {path})"


@dataclass
class Figures:
    """What came of a run."""

    cases: int = 0
    slowest: float = 0.0
    cpu: float = 0.0
    """Seconds of the case that took the most."""
    memory: float = 0.0
    """MiB of the case that took the most."""
    findings: list[str] = field(default_factory=list)


def count(kind: str, few: int) -> int:
    """Cases to try: few of them unless all are asked for."""
    return max(1, round(FULL[kind] * SHARE)) if SHARE else few


def fuzz(kind: str, few: int, attempt: Callable[[Case], None]) -> None:
    """Tries the cases of a kind; `attempt` raises for what it finds. Fails with all that was found."""
    figures, began = Figures(), time.monotonic()
    for number in [int(ONLY)] if ONLY else range(count(kind, few)):
        _try(kind, number, attempt, figures)
        if len(figures.findings) >= MOST:
            break
    report(kind, figures, time.monotonic() - began)


def report(kind: str, figures: Figures, seconds: float) -> None:
    """Says the figures, and fails with the findings."""
    print(
        f"\nfuzz {kind}: {figures.cases} cases, {len(figures.findings)} findings, "
        f"the slowest case {figures.slowest * 1000:.0f} ms, {figures.cpu:.2f} s of CPU, "
        f"the largest {figures.memory:.0f} MiB, {seconds:.0f} s"
    )
    assert not figures.findings, "\n".join(figures.findings)


def _try(kind: str, number: int, attempt: Callable[[Case], None], figures: Figures) -> None:
    quickest = float("inf")
    for _ in range(TRIES):
        case = Case.of(kind, number)
        began = time.monotonic()
        try:
            with ended_after(HUNG), measured(figures) as used:
                attempt(case)
            if kind in BOUNDED and (used.cpu > MOST_CPU or used.memory > MOST_MEMORY):
                raise AssertionError(f"it takes {used.cpu:.1f} s of CPU and {used.memory:.0f} MiB")
        except Exception as bug:
            figures.findings.append(case.keep(f"{type(bug).__name__}: {str(bug)[:500]}"))
            break
        quickest = min(quickest, (time.monotonic() - began) / max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1)))
        if quickest < SLOWEST:
            break
    else:
        figures.findings.append(case.keep(f"it takes {quickest:.1f} s"))
    figures.cases += 1
    figures.slowest = max(figures.slowest, 0.0 if quickest == float("inf") else quickest)


@contextlib.contextmanager
def measured(figures: Figures) -> Iterator[Figures]:
    """What the block takes, which counts in `figures` where it is more than before."""
    used = Figures()
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
    memory, cpu = _memory("VmRSS"), time.process_time()
    yield used
    used.cpu, used.memory = time.process_time() - cpu, _memory("VmHWM") - memory
    figures.cpu, figures.memory = max(figures.cpu, used.cpu), max(figures.memory, used.memory)


def _memory(name: str) -> float:
    """MiB, by a line of /proc/self/status."""
    status = Path("/proc/self/status").read_text()
    return int(status.partition(f"{name}:")[2].split()[0]) / 1024


@contextlib.contextmanager
def ended_after(seconds: int) -> Iterator[None]:
    def end(*_: object) -> None:
        raise TimeoutError(f"it hangs for more than {seconds} s")

    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
