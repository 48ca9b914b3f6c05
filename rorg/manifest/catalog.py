"""What a tree of manifests says, frozen: the one input of all decisions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from rorg.manifest.diagnostics import Where

DEVELOPER = "developer"
"""The built-in meta-service: a person. Always active, so its requests live until they are released."""

Spec = Mapping[str, Any]
"""A rendered container: `image`, `command` and options under Compose's names, in plain JSON values; only what is
declared. Exactly this is sent to the engine, and exactly this is digested."""


@dataclass(frozen=True, slots=True)
class Idle:
    action: str = "stop"
    """pause, stop or remove."""
    linger: float = 0.0
    """Seconds a service stays active after nobody wants it."""


@dataclass(frozen=True, slots=True)
class Ready:
    probe: str
    """delay, tcp or http."""
    target: float | str
    timeout: float = 30.0
    """Seconds after which the service counts as late."""
    interval: float = 0.25
    """Seconds between two probes."""


@dataclass(frozen=True, slots=True)
class Service:
    name: str
    meta: bool = False
    always_on: bool = False
    needs: tuple[str, ...] = ()
    """Names of services; groups are already replaced by their members."""
    conflicts: tuple[str, ...] = ()
    idle: Idle = Idle()
    ready: Ready | None = None
    restart: str = "always"
    """always, on-failure or never."""
    priority: int = 50
    cpu: float = 0.0
    """Expected use, cores."""
    memory: int = 0
    """Expected use, bytes."""
    driver: bool = False
    spec: Spec | None = None
    """None for a meta-service."""
    description: str = ""
    labels: Mapping[str, str] = field(default_factory=dict)
    where: Where = Where("")

    @property
    def container_name(self) -> str:
        return (self.spec or {}).get("container_name", self.name)


@dataclass(frozen=True, slots=True)
class Group:
    name: str
    services: tuple[str, ...]
    """Names of services; groups inside are already replaced by their members."""
    description: str = ""
    where: Where = Where("")


@dataclass(frozen=True, slots=True)
class Image:
    name: str
    context: str | None
    """Absolute directory of the build, or None."""
    dockerfile: str
    args: Mapping[str, str]
    import_command: tuple[str, ...] | None
    directory: str
    """Where the import command runs."""
    where: Where = Where("")


@dataclass(frozen=True, slots=True)
class Request:
    id: str
    requester: str
    services: tuple[str, ...]
    """As written: names of services or groups."""
    reason: str = ""
    incarnation: str | None = None
    """The run of the requester that sent it; None for meta-services, standing requests, and not yet bound ones."""
    standing: bool = False
    """Declared in a manifest, so it holds for every incarnation of its requester."""
    where: Where = Where("")

    @property
    def key(self) -> tuple[str, str]:
        return (self.requester, self.id)


@dataclass(frozen=True, slots=True)
class Policy:
    resync: float = 60.0
    bulk_workers: int = 2


@dataclass(frozen=True, slots=True)
class Catalog:
    services: Mapping[str, Service] = field(default_factory=dict)
    groups: Mapping[str, Group] = field(default_factory=dict)
    images: Mapping[str, Image] = field(default_factory=dict)
    requests: tuple[Request, ...] = ()
    policy: Policy = Policy()
    fingerprint: str = ""
    """Identity of the tree's content: two equal ones declare the same."""

    def members(self, name: str) -> tuple[str, ...]:
        """The services a name stands for: itself, a group's members, or nothing where the name is unknown."""
        if name in self.services:
            return (name,)
        return self.groups[name].services if name in self.groups else ()


EMPTY = Catalog(services={DEVELOPER: Service(DEVELOPER, meta=True)})
