"""What a tree says of the whole machine, frozen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Budget:
    """Of the whole machine; None for all that it has."""

    cpu: float | None = None
    """Cores."""
    memory: int | None = None
    """Bytes."""
    over: str = "admit"
    """admit, queue or refuse a request that would not fit."""


@dataclass(frozen=True, slots=True)
class Thresholds:
    """When measures against overload begin and end; `high` and `low` are fractions of the budget, `*_some` percent
    of time (PSI, avg10), `step` and `calm` seconds."""

    high: float = 1.0
    low: float = 0.85
    cpu_some: float | None = None
    memory_some: float | None = 20.0
    step: float = 0.5
    calm: float = 5.0
    admit: int = 60


@dataclass(frozen=True, slots=True)
class ImagePolicy:
    """When images are had, and how many are kept."""

    pull: str = "missing"
    """missing or never: what becomes of an external image that is not on the machine."""
    build: str = "missing"
    """The same for an Image of the tree."""
    keep: int = 5
    """States of the manifests whose images stay for a rollback."""


@dataclass(frozen=True, slots=True)
class HistoryPolicy:
    """How much of what happened is kept."""

    days: float = 400.0
    events: int = 100_000
    """Entries of the journal that are not about what people did."""
    revisions: int = 1000


@dataclass(frozen=True, slots=True)
class Policy:
    """What is said of the whole machine."""

    resync: float = 60.0
    bulk_workers: int | None = None
    """Engine calls at once for what no request waits for; None leaves it to whoever makes them."""
    budget: Budget | None = None
    pressure: Thresholds | None = None
    """None: load is not looked at."""
    resources: Mapping[str, int] = field(default_factory=dict)
    """Exclusive resource -> how many units there are; 1 where it is not named."""
    purge_ros: bool = True
    purge_shm: bool = True
    removals: str = "ask"
    """ask or auto."""
    images: ImagePolicy = ImagePolicy()
    history: HistoryPolicy = HistoryPolicy()
