"""The rules of docs/explanation/machines.md, as properties of random schedules over three machines in virtual time, and
what each schedule finds if the code of a rule is taken out.

`make machines` plays 100,000.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from machines_world import HOME, NAMES, Node, Violation, World

from rorg.core import links, ownership
from rorg.core.links import Granted, Link

COUNT = 100
ENOUGH = 300
"""Schedules in which a rule without its code must be broken."""


@pytest.mark.slow
def test_no_rule_is_broken_in_random_schedules():
    events = 0
    for seed in range(COUNT):
        world = World(seed)
        try:
            world.run()
        except Violation as broken:
            raise AssertionError(f"schedule {seed}: {broken}") from broken
        events += world.events
    print(f"{COUNT} schedules, {events} events, no violation")


def broken_by(seeds: range) -> str:
    """The first violation."""
    for seed in seeds:
        try:
            World(seed).run()
        except Violation as broken:
            return str(broken)
    return ""


def no_owner(patch: pytest.MonkeyPatch) -> None:
    """A machine starts whatever its manifests give it."""
    patch.setattr(ownership.Owned, "waits", lambda *_: "")


def early_answers(patch: pytest.MonkeyPatch) -> None:
    """An answer counts whenever its question was asked."""
    original = ownership.settled

    def settled(owned: Any, belongs: Any, here: str, present: Any, numbers: Any, granted: Any = ()) -> Any:
        after = original(owned, belongs, here, present, numbers, granted)
        everything = {n: dict.fromkeys((m for m in NAMES if m != here), 0) for n in HOME}
        confirmed = {**owned.confirmed, **after.confirmed}
        return replace(after, asked=everything, confirmed=confirmed)

    patch.setattr(ownership, "settled", settled)


def endless(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Granted, "live", lambda self, now: True)


def counted_from_the_answer(patch: pytest.MonkeyPatch) -> None:
    original = Link.answered

    def answered(self: Link, answer: Any) -> Link:
        after = original(self, answer)
        number = answer.newest[1]
        slow = [at for n, at in self.unanswered.items() if n > number]
        return replace(after, confirmed_at=max([after.confirmed_at or 0.0, *slow])) if after is not self else after

    patch.setattr(Link, "answered", answered)


def without_margin(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(links, "MARGIN", 0.0)


def ended_leases_stop_services(patch: pytest.MonkeyPatch) -> None:
    """Services that a silent machine asked for are kept from running."""
    import machines_world

    original = machines_world.peers

    def peers(*given: Any) -> Any:
        known = original(*given)
        granted = given[3]
        asked = {n for m in known.silent if m in granted for r in granted[m].renewal.requests for n in r.services}
        return replace(known, excluded={**known.excluded, **dict.fromkeys(asked, "its machine is silent")})

    patch.setattr(machines_world, "peers", peers)


def last_report_counts(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Link, "known", lambda self, now: self.report)


def no_fencing(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(links, "grant", lambda last, renewal, now: Granted(renewal, now))


def restart_forgets(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(links, "resumed", lambda granted, now: replace(granted, received=-1e9))


def differences(patch: pytest.MonkeyPatch) -> None:
    """A renewal says only what is new."""
    original = Node.send

    def send(self: Node, unowned: Any) -> None:
        requests = self.disk.requests
        told = {r for link in self.links.values() for r in (link.content[0] if link.content else ())}
        self.disk.requests = tuple(r for r in requests if r not in told)
        original(self, unowned)
        self.disk.requests = requests

    patch.setattr(Node, "send", send)


CODE: dict[str, list[Callable[[pytest.MonkeyPatch], None]]] = {
    "rule 1": [no_owner, early_answers],
    "rule 2": [endless],
    "rule 3": [without_margin, counted_from_the_answer],
    "rule 4": [ended_leases_stop_services],
    "rule 5": [last_report_counts],
    "rule 6": [no_fencing],
    "rule 7": [restart_forgets],
    "rule 8": [differences],
}


@pytest.mark.slow
@pytest.mark.parametrize(("rule", "change"), [(rule, change) for rule, changes in CODE.items() for change in changes])
def test_a_rule_without_its_code_is_broken(rule, change, monkeypatch):
    change(monkeypatch)
    assert broken_by(range(ENOUGH)).startswith(rule)
