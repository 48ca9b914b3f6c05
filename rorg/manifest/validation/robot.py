"""A whole tree as checks see it, and the findings that they return."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

from rorg.manifest.documents import Source
from rorg.manifest.files import real
from rorg.manifest.programs import HOST
from rorg.manifest.validation.subject import Subject
from rorg.model.catalog import Catalog
from rorg.model.diagnostics import Where
from rorg.model.graph import closure
from rorg.model.joining import SERVICE


@dataclass(frozen=True)
class Robot:
    """A whole tree: its services, and their relations."""

    catalog: Catalog
    sources: Mapping[str, Mapping[str, Source]]
    """By kind and name."""
    contained: bool = True
    """Whether its programs run in containers, with files and devices of their own."""

    @cached_property
    def subjects(self) -> tuple[Subject, ...]:
        services = self.catalog.services
        written = self.sources.get("Service", {})
        tops = {root: str(real(root)) for root in {s.root for s in written.values()}}
        return tuple(
            Subject(services[n], s, tops[s.root]) for n, s in sorted(written.items()) if services[n].spec is not None
        )

    @cached_property
    def in_containers(self) -> Robot:
        """The robot without services that only the process engine can run."""
        if all(s.options.get("image") != HOST for s in self.subjects):
            return self
        kept = {s.name: s.source for s in self.subjects if s.options.get("image") != HOST}
        return replace(self, sources={**self.sources, "Service": kept})

    @cached_property
    def by_name(self) -> Mapping[str, Subject]:
        return {s.name: s for s in self.subjects}

    @cached_property
    def ros1(self) -> tuple[Subject, ...]:
        return tuple(s for s in self.subjects if s.ros1)

    @cached_property
    def ros2(self) -> tuple[Subject, ...]:
        return tuple(s for s in self.subjects if s.ros2)

    @cached_property
    def masters(self) -> tuple[Subject, ...]:
        return tuple(s for s in self.subjects if s.is_master)

    @cached_property
    def _needed(self) -> dict[str, set[str]]:
        return {}

    def needs(self, name: str) -> set[str]:
        """The service and everything that it needs."""
        if name not in self._needed:
            self._needed[name] = closure(self.catalog.services, [name])
        return self._needed[name]

    def whose(self, subject: Subject, option: str) -> str:
        """The owner of a container's network (`network_mode`) or shared memory (`ipc`): `host`, the name of a service,
        or `container:NAME`."""
        passed: set[str] = set()
        while (value := str(subject.options.get(option) or "")).startswith(SERVICE) and subject.name not in passed:
            passed.add(subject.name)
            subject = self.by_name.get(value.removeprefix(SERVICE), subject)
        return value if value == "host" or ":" in value else subject.name

    def apart(self, one: Subject, other: Subject) -> bool:
        """Whether they are never active at the same time: they conflict, or both need more of an exclusive resource
        than exists."""
        a, b = one.service, other.service
        if a.name in b.conflicts or b.name in a.conflicts:
            return True
        there = self.catalog.policy.resources
        return any(
            units + b.exclusive.get(what, 0) > there.get(what, 1)
            for what, units in a.exclusive.items()
            if what in b.exclusive
        )

    def asks_for(self, subject: Subject) -> set[str]:
        """Everything that a service needs, or may request itself."""
        names = set(self.needs(subject.name))
        for name in subject.service.may_request:
            for member in self.catalog.members(name):
                names |= self.needs(member)
        for request in self.catalog.requests:
            if request.requester == subject.name:
                names |= {n for s in request.services for m in self.catalog.members(s) for n in self.needs(m)}
        return names


class Finding(NamedTuple):
    """One finding of a check. The table of codes has what holds for all findings of its code."""

    code: str
    where: Where
    message: str
    remedy: str = ""
    """Empty: the remedy of the table."""
    severity: str = ""
    """Empty: the severity of the table."""


Check = Callable[[Robot], Iterator[Finding]]


def each(check: Callable[[Subject], Iterator[Finding]]) -> Check:
    """A check of a robot that checks one service at a time."""
    return lambda robot: (finding for subject in robot.subjects for finding in check(subject))


def in_containers(check: Check) -> Check:
    """A check that only holds for programs in containers."""
    return lambda robot: check(robot.in_containers) if robot.contained else iter(())


def minority(subjects: Collection[Subject], values: Mapping[str, str]) -> list[tuple[Subject, str]]:
    """(service, most common value) of each service whose value is not the most common one, though all should agree."""
    counts = Counter(values[subject.name] for subject in subjects)
    usual = max(counts, key=lambda v: (counts[v], v), default="")
    return [(s, usual) for s in subjects if values[s.name] != usual]
