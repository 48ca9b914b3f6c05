"""What the random soak has done, and what rorg has acknowledged of it."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

from soak_random.judge import Answer, Hand
from soak_random.revisions import Tried
from soak_random.robot import DRIVERS, MOUNTING, REFUSED, SETS, Editions, Tree, with_needs


@dataclass(frozen=True)
class Asked:
    """A request that rorg has acknowledged."""

    services: tuple[str, ...]
    until: float | None = None
    """When its lease runs out, if nothing renews it or starts rorg again."""


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
    answers: list[Answer] = field(default_factory=list)
    states: list[tuple[float, Editions, dict[str, float]]] = field(default_factory=list)
    """When the tree was changed, what it declares since then, and when each file was written that is new."""
    touched: set[tuple[str, tuple[int, int]]] = field(default_factory=set)
    """Services and editions that somebody has ended by hand, so that rorg may think ill of them."""
    tried: dict[int, Tried] = field(default_factory=dict)
    """What is known of the revisions of rorg's history."""
    counts: Counter[str] = field(default_factory=Counter)
    errors: list[str] = field(default_factory=list)

    def count(self, what: str) -> None:
        with self.lock:
            self.counts[what] += 1

    # -- the tree ----------------------------------------------------------------------------------------------

    def changed(self, began: float, file: str = "") -> None:
        """The tree was changed, from `began` until now; `file`: the service whose file has new content."""
        with self.lock:
            before = dict(self.states[-1][2]) if self.states else {}
            now = self.tree.editions()
            if self.states:
                before = {s: at for s, at in before.items() if now[s][1] == self.states[-1][1][s][1]}
            self.states.append((began, now, before | ({file: began} if file else {})))

    @property
    def editions(self) -> Editions:
        return self.states[-1][1]

    def hand(self, hand: Hand) -> None:
        with self.lock:
            self.hands.append(hand)
            self.touched |= {(hand.service, now[hand.service]) for _, now, _ in self.states[-3:]}

    # -- answers -----------------------------------------------------------------------------------------------

    def ready(self, asked: float, names: Iterable[str], how: str) -> None:
        """rorg called services ready just now."""
        at, services = time.time(), tuple(sorted(with_needs(names)))
        with self.lock:
            begun = [n for n, (began, _, _) in enumerate(self.states) if began <= asked]
            states = self.states[begun[-1] if begun else 0 :]
            sure = [s for s in services if self._sure(s, [now for _, now, _ in states])]
            editions = {s: frozenset(now[s][0] for _, now, _ in states) for s in sure}
            files = states[0][2] if len(states) == 1 else {}
            files = {s: files[s] for s in sure if s in files and s in MOUNTING}
            self.answers.append(Answer(asked, at, services, editions, files, how))

    def _sure(self, service: str, states: Iterable[Editions]) -> bool:
        """Whether rorg must run what one of these states declares: nothing is wrong with it."""
        partners = next((s for s in SETS if service in s), frozenset((service,)))
        kinds = self.tree.kinds
        if service in DRIVERS or any(kinds[n] == REFUSED for now in states for n, _ in now.values()):
            return False
        editions = {(one, now[one]) for one in partners for now in states}
        return not any(kinds[n] != "good" for _, numbers in editions for n in numbers) and not editions & self.touched
