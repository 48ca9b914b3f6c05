"""The registry of invariants: each promise by its name, with the moment at which it is checked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from bounded.watch import Watch


class Violation(AssertionError):
    """A broken promise; `name` is that of the invariant."""

    def __init__(self, name: str, why: str) -> None:
        super().__init__(f"{name}: {why}")
        self.name = name


@dataclass(frozen=True)
class Invariant:
    """One promise, and the moment at which it is checked."""

    moment: str
    holds: Callable[[Watch], None]
    """Raises AssertionError if it does not hold."""


INVARIANTS: dict[str, Invariant] = {}


def at(moment: str) -> Callable[[Callable[[Watch], None]], Callable[[Watch], None]]:
    """Register an invariant under its function's name, in words."""

    def register(holds: Callable[[Watch], None]) -> Callable[[Watch], None]:
        INVARIANTS[holds.__name__.replace("_", " ")] = Invariant(moment, holds)
        return holds

    return register


def check(moment: str, watch: Watch) -> None:
    """Check all invariants of a moment. Raises Violation."""
    for name, invariant in INVARIANTS.items():
        if invariant.moment == moment:
            try:
                invariant.holds(watch)
            except AssertionError as broken:
                raise Violation(name, str(broken)) from broken
