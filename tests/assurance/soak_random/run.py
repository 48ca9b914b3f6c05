"""A random soak on Docker: `python -m soak_random.run MINUTES SEED`. It requests, edits, breaks and freezes at random,
and judges rorg by the events of the engine. Exit code 1 if anything is wrong."""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import commands
from common import wait_for
from dockerd import Dockerd, own_dockerd
from histories import entries
from soak_random.actions import Actor, Requester
from soak_random.book import Book
from soak_random.checkpoint import Checkpoint
from soak_random.judge import Fault, false_ready, overlaps, runs_of
from soak_random.robot import Rorg, Tree, rules, with_needs
from soak_random.witness import Witness

REQUESTERS = 2
PERIOD = 40.0
"""Seconds of actions between two checkpoints."""
AROUND = 6.0
"""Seconds of events before and after a fault that are shown."""
KINDS = ("overlap", "ready", "lost", "history")


@dataclass
class Soak:
    folder: Path
    dockerd: Dockerd
    seed: int
    say: Callable[[str], None] = print
    period: float = PERIOD
    faults: list[Fault] = field(default_factory=list)
    """Each once."""

    def __post_init__(self) -> None:
        tree = Tree(self.folder / "robot")
        tree.begin()
        self.book, self.witness = Book(tree), Witness(self.dockerd.host)
        self.book.changed(time.time())
        self.rorg = Rorg(self.folder, tree.root, self.dockerd.host)
        self.rules, self.checkpoints, self.judged_at = rules(), 0, 0.0
        self.requesters: list[Requester] = []
        self.log = self.folder / "actions.log"

    def run(self, seconds: float) -> list[Fault]:
        began = time.monotonic()
        self.witness.start()
        self.rorg.start()
        self.requesters = [Requester(n, self.rorg, self.book, self.seed) for n in range(REQUESTERS)]
        actor = Actor(self.rorg, self.dockerd, self.book, self.witness, self.seed)
        checkpoint = Checkpoint(self.rorg, self.book, self.witness)
        checkpoint.client.wait("clock", timeout=120.0)
        for one in self.requesters:
            one.start()
        while time.monotonic() - began < seconds:
            self._disturb(actor, min(self.period, max(5.0, seconds - (time.monotonic() - began))))
            self._check(checkpoint, time.monotonic() - began)
        return self.faults

    def _disturb(self, actor: Actor, seconds: float) -> None:
        end = time.monotonic() + seconds
        for one in self.requesters:
            one.may.set()
        with self.log.open("a") as log:
            while time.monotonic() < end:
                began = time.time()
                print(f"{began:.3f} {actor.act()} {time.time() - began:.1f} s", file=log, flush=True)
                actor.pause(actor.dice.uniform(0.05, 1.2))
        for one in self.requesters:
            one.may.clear()
            one.idle.clear()
        for one in self.requesters:
            wait_for(one.idle.is_set, 180, "requests to be answered")

    def _check(self, checkpoint: Checkpoint, at: float) -> None:
        self.checkpoints += 1
        found = checkpoint.check() + self.judged()
        fresh = [fault for fault in found if (fault.kind, fault.what) not in {(f.kind, f.what) for f in self.faults}]
        self.faults += fresh
        counts = Counter(fault.kind for fault in self.faults)
        total = sum(self.book.counts.values())
        told = ", ".join(f"{kind} {counts[kind]}" for kind in KINDS)
        self.say(f"{at / 60:5.1f} min  checkpoint {self.checkpoints}  {total} actions  {told}")
        for number, fault in enumerate(fresh, len(self.faults) - len(fresh) + 1):
            self._show(number, fault)

    def judged(self) -> list[Fault]:
        """By all events of the engine so far, and the answers since the checkpoint before."""
        runs = runs_of(self.witness.known(), self.book.hands)
        found = overlaps(runs, self.rules, self.rorg.away, time.time())
        answers, self.judged_at = self.book.answers(self.judged_at), time.time()
        return found + [fault for answer in answers for fault in false_ready(answer, runs)]

    # -- evidence ----------------------------------------------------------------------------------------------

    def _show(self, number: int, fault: Fault) -> None:
        self.say(f"  FAULT {number} {fault.kind} at {fault.at:.3f}: {fault.what}")
        concerned = with_needs(fault.services)
        events = [e for e in self.witness.known() if abs(e.at - fault.at) < AROUND or e.service in fault.services]
        events = [e for e in events if abs(e.at - fault.at) < 10 * AROUND]
        near = [f"{e.at:.3f} {e.action} {e.service} {e.container[:8]} edition {e.edition} {e.signal}" for e in events]
        hands = [str(h) for h in self.book.hands if abs(h.begin - fault.at) < 10 * AROUND]
        away = [str(s) for s in self.rorg.away if abs(s.begin - fault.at) < 10 * AROUND]
        why = [self._told("why", s) for s in fault.services] + [self._told("get"), self._told("history", "-o", "wide")]
        journal = [json.dumps(e) for e in entries(self.rorg.state / "journal.db")[-400:]]
        journal = [line for line in journal if not concerned or any(f'"{name}"' in line for name in concerned)][-150:]
        parts = {"events": near, "hands": hands, "away": away, "why": why, "journal": journal}
        parts |= {"actions": self.log.read_text().splitlines()[-60:], "requests": [str(self.book.requests)]}
        parts |= {"editions": [str({s: n for s, n in self.book.editions.items() if n != (0, 0)})]}
        parts |= {"kinds": [str({n: k for n, k in self.book.tree.kinds.items() if k != "good"})]}
        text = "\n\n".join(f"== {name}\n" + "\n".join(lines) for name, lines in parts.items())
        (self.folder / f"fault-{number}.txt").write_text(f"{fault.kind} at {fault.at:.3f}: {fault.what}\n\n{text}\n")

    def _told(self, *words: str) -> str:
        done = commands.run([*words], self.rorg.environment(), cwd=self.rorg.folder, timeout=120.0)
        return f"$ rorg {' '.join(words)}\n{done.stdout}{done.stderr}"

    def close(self) -> None:
        for one in self.requesters:
            one.over.set()
            one.client.hang_up()
        self.witness.stop()
        self.rorg.close()
        for one in self.requesters:
            one.join(100)


def main(minutes: float, seed: int) -> int:
    folder = Path(tempfile.mkdtemp(prefix="soak-", dir="/tmp"))
    print(f"seed {seed}, {minutes:g} minutes, evidence in {folder}", flush=True)
    with own_dockerd("--live-restore") as dockerd:
        soak = Soak(folder, dockerd, seed, say=lambda line: print(line, flush=True))
        try:
            soak.run(60 * minutes)
        finally:
            soak.close()
    counts, kinds = soak.book.counts, Counter(fault.kind for fault in soak.faults)
    print(f"{soak.checkpoints} checkpoints, {counts.total()} actions: {dict(sorted(counts.items()))}")
    print(f"{len(soak.witness.events)} events, {len(soak.book.answers())} answers that called something ready")
    print(f"{len(soak.book.errors)} calls without an answer: {soak.book.errors[:5]}")
    print(", ".join(f"{kind} {kinds[kind]}" for kind in KINDS))
    return 1 if soak.faults else 0


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1]), int(sys.argv[2])))
