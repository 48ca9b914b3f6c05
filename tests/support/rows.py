"""Rows of the table of speed: what rorg takes, what stands beside it, and the goal."""

from __future__ import annotations

import os
import statistics
import subprocess
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import psutil
from common import wait_for

BUSY = float(os.environ.get("BUSY", "0.1"))
"""The part of the CPU that other programs may use when a turn begins."""


def nothing() -> None:
    """For work that needs no return to where it began."""


@dataclass(frozen=True)
class Row:
    """One measured line. Without `beside`, the goal is of the figure itself; with it, of their ratio."""

    work: str
    ours: float
    unit: str
    goal: float
    beside: float | None = None
    other: str = ""

    @property
    def value(self) -> float:
        """What is compared with the goal."""
        return self.ours if self.beside is None else self.ours / self.beside

    @property
    def met(self) -> bool:
        return self.value <= self.goal

    def __str__(self) -> str:
        ratio = "" if self.beside is None else f"{self.other} {self.beside:.4g} {self.unit}, {self.value:.2f} x"
        goal = f"{self.goal:g} {'x' if self.beside is not None else self.unit}"
        return f"| {self.work} | {self.ours:.4g} {self.unit} | {ratio} | {goal} | {'yes' if self.met else 'no'} |"


@dataclass
class Table:
    rows: list[Row] = field(default_factory=list)

    def add(self, row: Row) -> None:
        self.rows.append(row)
        print(f"\n{row}", end="", flush=True)


def milliseconds(call: Callable[[], object]) -> float:
    began = time.perf_counter()
    call()
    return 1000 * (time.perf_counter() - began)


@dataclass(frozen=True)
class Side:
    """One of two that are measured in turn: the call that counts, and what undoes it. With a `host`, the engine there
    must say that `running` containers run when the call returns, and the other side's turn begins when that engine has
    what it had before."""

    call: Callable[[], object]
    undo: Callable[[], object] = nothing
    host: str = ""
    running: int = 0

    def turn(self) -> float:
        """Milliseconds of the call, on a quiet machine."""
        quiet()
        before = states(self.host) if self.host else None
        took = milliseconds(self.call)
        if self.host:
            found = states(self.host)
            assert found["running"] == self.running, f"{dict(found)}, not {self.running} that run"
        self.undo()
        if before is not None:
            wait_for(lambda: states(self.host) == before, 300, f"what was there before: {dict(before)}")
        return took


def states(host: str) -> Counter[str]:
    """How many containers the engine has in each state; one that is being removed is one, too."""
    words = ["docker", "-H", host, "ps", "--all", "--format", "{{.State}}"]
    return Counter(subprocess.run(words, capture_output=True, text=True, check=True).stdout.split())


def quiet() -> None:
    """Wait until nothing else works on this machine, as the end of what was measured before does."""
    wait_for(lambda: psutil.cpu_percent(0.5) <= 100 * BUSY, 120, f"a machine that is less than {BUSY:.0%} busy")


def alternating(rounds: int, ours: Side, theirs: Side) -> tuple[float, float]:
    """The medians of two calls, made in turn, in milliseconds."""
    one, other = zip(*((ours.turn(), theirs.turn()) for _ in range(rounds)), strict=True)
    return statistics.median(one), statistics.median(other)
