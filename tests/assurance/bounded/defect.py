"""A defect to plant in a copy of rorg, and the words that the lists of them share.

`old` occurs once in the file. The features (worlds.py) describe the world in which the defect shows, and `steps` how
long a sequence it needs.
"""

from __future__ import annotations

from dataclasses import dataclass

from bounded.walks import Walk


@dataclass(frozen=True)
class Defect:
    """One change of one file of rorg, and the invariants of which one must catch it."""

    name: str
    file: str
    old: str
    new: str
    caught_by: tuple[str, ...]
    services: int = 1
    features: tuple[tuple[str, ...], ...] = ()
    steps: int = 2
    path: tuple[tuple[tuple, float], ...] = ()
    """Steps that show it, if a search for them takes long."""
    walk: Walk | None = None
    """A walk that shows it, instead of worlds."""


PLAN, FRESH = "the plan keeps its rules", "a kept pass decides as a fresh one"
READY, SERVED = "ready means ready", "all that is asked for and possible is ready"
REST, EMPTY, BOUNDED = "it comes to rest", "the plan is empty twice", "it converges in bounded passes"
RIVALS, TOGETHER = "nothing begins against rivals", "rivals never run together"
TRIED = "nothing fails that was not tried"
RULE, LEASES, KEPT = "the wanted follow the rule", "leases run out", "no request is lost or doubled"
GOOD, SAME, BAKE = (
    "the good stay until the next is proven",
    "the same is not created again",
    "a bake ends with evidence",
)
IDLE, RUN, TOLD = "the idle are as declared", "only the wanted run", "the wanted run or are explained"
NEEDS, ONE = "needs are ready first", "one container of a service"
REQUEST, THEN = (("request", 0), 150.0), (("request", 1), 150.0)
CHANGEOVER = (REQUEST, (("release", 0), 0.0), THEN)
NEED, RESTART = (("needs", "1", "0"),), (("needs", "1", "0"), ("restart", "1", "0"))
GPU, CONFLICT = (("gpu", "0", "1"),), (("conflict", "0", "1"),)
BUS = (("bus", "0", "1", "2"),)
ESCALATES = (*CONFLICT, ("escalate", "0"))
PROBE, ALWAYS = (("probe", "0"),), (("always", "0"),)
