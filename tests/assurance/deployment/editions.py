"""Which edition of each service must run, by what was pushed: that of the last commit that is valid; if it is bad
there, the one before."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from deployment.week import Bad, Event, Kind


@dataclass(frozen=True)
class Edition:
    software: int = 0
    configuration: int = 0
    bad: Bad = Bad.NO

    @property
    def answer(self) -> str:
        """What the stand-in says."""
        return f"{self.software} {self.configuration}"


class Editions:
    def __init__(self, services: Iterable[str]) -> None:
        self.head = dict.fromkeys(services, Edition())
        """As pushed last."""
        self.right = {name: frozenset((Edition().answer,)) for name in self.head}
        """Service -> answers that are right. There are two if the last edition is bad and the good one before it has
        never run: rorg goes back to what it knows to be good."""
        self._before: dict[str, Edition] = {}
        """Service -> the edition before a bad one."""

    def updated(self, event: Event, number: int) -> Edition:
        before = self.head[event.service]
        if event.bad:
            self._before[event.service] = before
        if event.kind is Kind.SOFTWARE:
            return replace(before, software=number, bad=event.bad)
        return replace(before, configuration=number, bad=event.bad)

    def reverted(self, event: Event) -> Edition:
        return self._before.pop(event.service)

    def pushed(self, name: str, edition: Edition, answers: Mapping[str, str]) -> None:
        """`answers`: what each service said last."""
        self.head[name] = edition
        if any(one.bad is Bad.INVALID for one in self.head.values()):
            return  # the commit is refused, with all that is in it
        for service, one in self.head.items():
            if not one.bad:
                self.right[service] = frozenset((one.answer,))
            elif service in answers:
                self.right[service] |= {answers[service]}
