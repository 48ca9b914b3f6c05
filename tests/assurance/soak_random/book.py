"""What the random soak has done, and what rorg has acknowledged of it."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import inf

from soak_random.judge import Answer, Hand
from soak_random.revisions import Tried
from soak_random.robot import DRIVERS, REFUSED, SETS, Editions, Tree, with_needs


@dataclass(frozen=True)
class Asked:
    """A request that rorg has acknowledged."""

    services: tuple[str, ...]
    until: float | None = None
    """When its lease runs out, if nothing renews it or starts rorg again."""


@dataclass(frozen=True)
class State:
    """What the tree declares after a change, which was made from `began` to `ended`."""

    began: float
    ended: float
    editions: Editions
    files: Mapping[str, float]
    """Service -> when the file that it mounts was written, if its content is new."""


@dataclass
class Book:
    """Written by several threads, each with `lock`."""

    tree: Tree
    lock: threading.RLock = field(default_factory=threading.RLock)
    requests: dict[str, Asked] = field(default_factory=dict)
    holds: dict[str, float] = field(default_factory=dict)
    """Service -> until when."""
    unknown: set[str] = field(default_factory=set)
    """Requests and holds of which it is not known whether rorg has done what was last asked for."""
    hands: list[Hand] = field(default_factory=list)
    states: list[State] = field(default_factory=list)
    touched: set[tuple[str, tuple[int, int]]] = field(default_factory=set)
    """Services and editions that somebody has ended by hand, so that rorg may think ill of them."""
    tried: dict[int, Tried] = field(default_factory=dict)
    """What is known of the revisions of rorg's history."""
    counts: Counter[str] = field(default_factory=Counter)
    errors: list[str] = field(default_factory=list)
    _ready: list[Answer] = field(default_factory=list)

    def count(self, what: str) -> None:
        with self.lock:
            self.counts[what] += 1

    # -- the tree ----------------------------------------------------------------------------------------------

    def changed(self, began: float, file: str = "") -> None:
        """The tree was changed, from `began` until now; `file`: the service whose file has new content."""
        with self.lock:
            now, files = self.tree.editions(), {}
            if self.states:
                last = self.states[-1]
                files = {s: at for s, at in last.files.items() if now[s][1] == last.editions[s][1]}
            self.states.append(State(began, time.time(), now, files | ({file: began} if file else {})))

    @property
    def editions(self) -> Editions:
        return self.states[-1].editions

    def hand(self, hand: Hand) -> None:
        with self.lock:
            self.hands.append(hand)
            self.touched |= {(hand.service, state.editions[hand.service]) for state in self.states[-3:]}

    # -- answers -----------------------------------------------------------------------------------------------

    def ready(self, asked: float, names: Iterable[str], how: str) -> None:
        """rorg called services ready just now."""
        with self.lock:
            self._ready.append(Answer(asked, time.time(), tuple(sorted(with_needs(names))), how=how))

    def answers(self, since: float = 0.0) -> list[Answer]:
        """With the editions that may have run: those that the tree declared at any time between question and answer."""
        with self.lock:
            return [self._with_editions(answer) for answer in self._ready if answer.at >= since]

    def _with_editions(self, answer: Answer) -> Answer:
        ends = [state.ended for state in self.states[1:]] + [inf]
        pairs = zip(self.states, ends, strict=True)
        states = [state for state, end in pairs if state.began <= answer.at and end > answer.asked]
        sure = [s for s in answer.services if self._sure(s, [state.editions for state in states])]
        editions = {s: frozenset(state.editions[s][0] for state in states) for s in sure}
        files = states[0].files if len(states) == 1 else {}
        return replace(answer, editions=editions, files={s: files[s] for s in sure if s in files})

    def _sure(self, service: str, states: Iterable[Editions]) -> bool:
        """Whether rorg must run what one of these states declares: nothing is wrong with it."""
        partners = next((s for s in SETS if service in s), frozenset((service,)))
        kinds = self.tree.kinds
        if service in DRIVERS or any(kinds[n] == REFUSED for now in states for n, _ in now.values()):
            return False
        editions = {(one, now[one]) for one in partners for now in states}
        return not any(kinds[n] != "good" for _, numbers in editions for n in numbers) and not editions & self.touched
