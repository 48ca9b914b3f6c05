"""Settings for the whole machine, frozen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Budget:
    """Budget of the whole machine; None means everything it has."""

    cpu: float | None = None
    """Cores."""
    memory: int | None = None
    """Bytes."""
    over: str = "admit"
    """admit, queue or refuse: what to do with a request that does not fit."""


@dataclass(frozen=True, slots=True)
class Thresholds:
    """When measures against overload begin and end. `high` and `low` are fractions of the budget, `*_some` percent of
    time (PSI, avg10), `step` and `calm` seconds."""

    high: float = 1.0
    low: float = 0.85
    cpu_some: float | None = None
    memory_some: float | None = 20.0
    step: float = 0.5
    calm: float = 5.0
    admit: int = 60


@dataclass(frozen=True, slots=True)
class ImagePolicy:
    """When images are pulled or built, and how many are kept."""

    pull: str = "missing"
    """missing or never: when to pull an external image."""
    build: str = "missing"
    """The same for building an Image of the tree."""
    keep: int = 5
    """Revisions of the manifests whose images are kept for a rollback."""


@dataclass(frozen=True, slots=True)
class HistoryPolicy:
    """How much history is kept."""

    days: float = 400.0
    events: int = 100_000
    """Maximum number of journal entries, except those about people's actions."""
    revisions: int = 1000


@dataclass(frozen=True, slots=True)
class Webhook:
    """Where a notification is posted, and in which form."""

    url: str | None = None
    url_file: str | None = None
    """A file with the URL; exactly one of both is given."""
    headers_file: str | None = None
    template: str | Mapping[str, Any] | None = None
    """None: all fields as JSON."""


@dataclass(frozen=True, slots=True)
class NotifyTarget:
    """Someone to notify: by a command or a webhook. `every` and `timeout` are in seconds."""

    name: str
    kinds: tuple[str, ...]
    """Of NOTIFY_KINDS."""
    command: tuple[str, ...] = ()
    webhook: Webhook | None = None
    every: float = 10.0
    """At most one notification of a kind about a subject in this time."""
    timeout: float = 10.0
    """For one attempt."""


NOTIFY_KINDS = ("lost", "quarantined", "failed", "pressure", "unplugged")
NOTIFY_FIELDS = ("robot", "kind", "event", "service", "message", "cause", "at", "seq", "suppressed")
"""The fields of a notification, as its JSON and the templates of webhooks name them."""


@dataclass(frozen=True, slots=True)
class Policy:
    """The Policy of the whole machine."""

    resync: float = 60.0
    bulk_workers: int | None = None
    """Concurrent engine calls for work that no request waits for; None leaves it to the caller."""
    budget: Budget | None = None
    pressure: Thresholds | None = None
    """None: load is not monitored."""
    resources: Mapping[str, int] = field(default_factory=dict)
    """Exclusive resource -> number of units; 1 if it is not listed."""
    purge_ros: bool = True
    purge_shm: bool = False
    removals: str = "ask"
    """ask or auto."""
    images: ImagePolicy = ImagePolicy()
    history: HistoryPolicy = HistoryPolicy()
    notify: tuple[NotifyTarget, ...] = ()
