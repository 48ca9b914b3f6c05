"""Rows of the table of speed: what rorg takes, what stands beside it, and the goal."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field


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


def alternating(
    rounds: int,
    ours: Callable[[], object],
    theirs: Callable[[], object],
    back: Callable[[], object] = nothing,
    their_back: Callable[[], object] = nothing,
    pause: float = 0.0,
) -> tuple[float, float]:
    """The medians of two calls, made in turn, in milliseconds; `back` undoes each and does not count."""
    found: list[tuple[float, float]] = []
    for _ in range(rounds):
        time.sleep(pause)
        one = milliseconds(ours)
        back()
        time.sleep(pause)
        found.append((one, milliseconds(theirs)))
        their_back()
    one, other = zip(*found, strict=True)
    return statistics.median(one), statistics.median(other)
