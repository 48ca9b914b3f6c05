"""Explores a world: every sequence of steps up to a depth, each state once, with all invariants after every pass."""

from __future__ import annotations

import hashlib
import math
import random
import time
from dataclasses import dataclass, field
from functools import partial

from bounded.invariants import Violation, Watch, check
from bounded.state import digest_of
from bounded.steps import Step, alphabet, take
from bounded.virtual import WorldRobot
from bounded.worlds import State, World, begin

REST = 150.0
"""Seconds after the last step. No fault of the alphabet lasts longer, and the last 100 of them must be quiet."""
PATIENCE = 10.0
"""Seconds between passes at rest, while probes say what they said before."""
MOST_PASSES = 400
"""Passes in which a robot comes to rest."""
WAYPOINTS = (2.0,)
"""Seconds after a step at which it is seen whether a robot goes on as one before it did."""
Path = tuple[tuple[Step, float], ...]
"""Steps, each with the seconds after it until the next one; REST for the end of all that it causes."""


@dataclass
class Found:
    """A broken promise, and how to come to it."""

    world: World
    path: Path
    violation: Violation

    def __str__(self) -> str:
        return f"{self.world.label}: {self.path}\n{self.violation}"


@dataclass
class Tally:
    """What an exploration covered."""

    worlds: int = 0
    steps: int = 0
    states: int = 0
    """Different states from which all steps were taken."""
    merged: int = 0
    """Steps that led to a state from which all that comes is known."""
    passes: int = 0
    found: list[Found] = field(default_factory=list)
    began: float = field(default_factory=time.monotonic)
    decisions: hashlib._Hash | None = None
    """Digest of all decisions, if it is wanted."""

    def add(self, other: Tally) -> None:
        """Add what another exploration covered."""
        for name in ("worlds", "steps", "states", "merged", "passes"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.found += other.found

    def __str__(self) -> str:
        seconds = time.monotonic() - self.began
        return (
            f"{self.worlds} worlds, {self.steps} steps, {self.states} states, {self.merged} merged, "
            f"{self.passes} passes, {seconds:.0f} s, {len(self.found)} violations"
        )


@dataclass
class Node:
    """A robot in a world, and how it came there. `quick` is how many pauses before its rest are left to it."""

    robot: WorldRobot
    watch: Watch
    state: State
    quick: int
    path: Path = ()

    def fork(self) -> Node:
        robot = self.robot.fork()
        return Node(robot, self.watch.fork(robot), self.state, self.quick, self.path)

    def digest(self) -> bytes:
        return digest_of(self.robot, self.state)


@dataclass(frozen=True)
class Bound:
    """Which worlds, and which sequences of steps in each.

    - `services`, `features`: see worlds();
    - `steps`: the length of a sequence;
    - `asked`: the first step is a request that was served, or one that is being served;
    - `pauses`: seconds that may pass between two steps instead of REST, in `quick` places of a sequence.
    """

    services: int
    features: int
    steps: int
    asked: bool
    pauses: tuple[float, ...]
    quick: int = 1


@dataclass
class Explorer:
    """Explores one world. `sample` takes only so many steps of each state, chosen by `seed`; None takes all."""

    world: World
    bound: Bound
    tally: Tally
    sample: int | None = None
    seed: int = 0
    expanded: dict[bytes, int] = field(default_factory=dict)
    """States from which all steps are taken, with the pauses that were left."""
    first: bool = False
    """Whether to stop at the first violation."""
    followed: set[bytes] = field(default_factory=set)
    """States from which a robot was followed to its rest, and kept all promises."""

    def run(self) -> None:
        chance = random.Random(f"{self.seed} {self.world.label}")
        root = start(self.world, self.bound.quick)
        root.watch.sparing = not self.first
        self.tally.worlds += 1
        if not self._rest(root):
            return
        frontier, steps = [root], alphabet(self.world)
        for level in range(self.bound.steps):
            last, following = level == self.bound.steps - 1, list[Node]()
            first = [s for s in steps if s[0] == "request"] if level == 0 and self.bound.asked else steps
            for node in frontier:
                some = first if self.sample is None else chance.sample(first, min(self.sample, len(first)))
                for step in some:
                    following += self._branch(node, step, last)
                    if self.first and self.tally.found:
                        return
            frontier = following

    def _branch(self, node: Node, step: Step, last: bool) -> list[Node]:
        """Return the new states that a step leads to, one for each pause. Where it meets a state that was followed to
        its rest before, it goes no further, because all that comes of it is known."""
        child, found = node.fork(), list[Node]()
        state = take(self.world, child.robot, child.state, step)
        if state is None:
            return []
        child.state, began = state, child.robot.now
        self.tally.steps += 1
        pauses, followed = self.bound.pauses if child.quick and not last else (), set[bytes]()
        for pause in (*pauses, *WAYPOINTS, REST):
            child.path = (*node.path, (step, pause))
            ended = self._rest(child) if pause == REST else self._advance(child, began + pause)
            if not ended:
                return found
            digest, quick = child.digest(), child.quick - (pause != REST)
            if not last and pause not in WAYPOINTS and self.expanded.get(digest, -1) < quick:
                self.expanded[digest] = quick
                self.tally.states += 1
                found.append(child.fork())
                found[-1].quick = quick
            if digest in self.followed:
                self.tally.merged += 1
                break
            followed.add(digest)
        self.followed |= followed
        return found

    def _rest(self, node: Node) -> bool:
        """Let nothing happen for a long time, and judge the rest. Return whether all promises were kept."""
        robot = node.robot
        robot.patience = PATIENCE
        ended = self._advance(node, float(math.ceil(robot.now + REST)), MOST_PASSES, "rest")
        robot.patience = 0.0
        robot.spoilt.clear()  # no call came that could go wrong
        return ended

    def _advance(self, node: Node, until: float, most: int = 10**9, moment: str = "") -> bool:
        watch, before = node.watch, self.tally.passes
        try:
            node.robot.pass_until(until, partial(self._passed, node))
            if self.tally.passes - before > most:
                raise Violation("it converges in bounded passes", f"{self.tally.passes - before} passes")
            if moment:
                check(moment, watch)
        except AssertionError as broken:
            violation = broken if isinstance(broken, Violation) else Violation("the plan keeps its rules", str(broken))
            self.tally.found.append(Found(self.world, node.path, violation))
            return False
        return True

    def _passed(self, node: Node) -> None:
        self.tally.passes += 1
        node.watch.passed()
        if self.tally.decisions is not None:
            decision = node.robot.decision
            said = decision.plan.text(), [str(a) for a in decision.begin], [r.key for r in decision.settled.requests]
            self.tally.decisions.update(repr((round(node.robot.now, 6), said)).encode())


def start(world: World, quick: int) -> Node:
    """A robot in a world before its first pass."""
    robot = begin(world)
    return Node(robot, Watch(robot, check, sparing=True), world.manifests.first(), quick)


def replay(world: World, path: Path) -> Found | None:
    """Walk one path from the beginning, and return the promise that breaks, if any."""
    tally = Tally()
    explorer = Explorer(world, Bound(len(world.names), 0, len(path), False, ()), tally)
    node = start(world, 0)
    robot = node.robot
    explorer._rest(node)
    for step, pause in path:
        if tally.found:
            break
        node.path = (*node.path, (step, pause))
        state = take(world, robot, node.state, step)
        if state is None:
            continue
        node.state = state
        explorer._rest(node) if pause == REST else explorer._advance(node, robot.now + pause)
    if not tally.found:
        explorer._rest(node)
    return tally.found[0] if tally.found else None
