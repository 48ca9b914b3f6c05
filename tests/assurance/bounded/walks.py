"""Random walks: a random robot, and some sixty steps that close upon one another. All invariants hold after every pass,
with every call, and whenever the robot comes to rest.

A walk is drawn from a seed and a number, and can be walked again with fewer steps and features: shrink() finds the
shortest way to break the same promise.
"""

from __future__ import annotations

import gc
import json
import math
import random
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from bounded.invariants import Violation, Watch, check
from bounded.steps import Step
from bounded.walk_robot import WalkRobot
from bounded.walk_steps import GLOBAL, PAIRS, WEIGHTS, take
from bounded.walk_worlds import WalkWorld, draw_features, world_of
from bounded.worlds import Feature
from common import ROOT

CASES = ROOT / "tests/cases/walks"
STEPS = 95
"""Steps that are drawn. A third of them is impossible when its turn comes."""
REST = 250.0
"""Seconds after the last step. No fault of a walk lasts longer, and the last 100 of them must be quiet."""
PATIENCE = 10.0
"""Seconds between passes at rest, while probes say what they said before."""
MOST_PASSES = 1000
"""Passes in which a robot comes to rest."""
PAUSES = (0.0, 0.0, 0.0, 0.0, 0.01, 0.02, 0.05, 0.1, 0.1, 0.3, 0.6, 1.0, 2.5, 6.0)
"""Seconds after a step. With none, the next step falls into the same pass."""
RESTS = 0.02
"""How often a robot comes to rest after a step, instead of a pause."""
SELDOM = (50_000, 50, 1000)
"""Thresholds of garbage collection."""
TMPFS = "/dev/shm"
Steps = tuple[tuple[Step, float], ...]


@dataclass(frozen=True)
class Walk:
    """A robot with so many services and these features, and steps with the seconds after each."""

    services: int
    features: tuple[Feature, ...]
    steps: Steps

    def __str__(self) -> str:
        world = " ".join("".join(f) for f in self.features) or "plain"
        steps = "; ".join(f"{' '.join(map(str, s))} +{p:g}" for s, p in self.steps)
        return f"{self.services} services, {world}: {steps}"


@dataclass
class Tally:
    """What walks covered."""

    walks: int = 0
    steps: int = 0
    """Steps that happened. Impossible ones do not count."""
    passes: int = 0
    began: float = field(default_factory=time.process_time)

    def __str__(self) -> str:
        seconds = time.process_time() - self.began
        rate = self.steps / seconds if seconds else 0.0
        return f"{self.walks} walks, {self.steps} steps, {self.passes} passes, {seconds:.0f} s, {rate:.0f} steps/s"


def draw(seed: object, number: int) -> Walk:
    """Return the walk with this number."""
    chance = random.Random(f"{seed} {number}")
    while True:
        services, features = draw_features(chance)
        world = world_of(services, features)
        if world is not None and world.trees.load(world.trees.first()) is not None:
            return Walk(services, features, tuple(_steps(services, chance)))


def _steps(services: int, chance: random.Random) -> Iterator[tuple[Step, float]]:
    verbs = [v for v in WEIGHTS if services > 1 or v not in PAIRS]
    drawn = chance.choices(verbs, [WEIGHTS[v] for v in verbs], k=STEPS)
    for verb in drawn:
        about = 0 if verb in GLOBAL else 2 if verb in PAIRS else 1
        step = (verb, *chance.sample(range(services), about))
        yield step, REST if chance.random() < RESTS else chance.choice(PAUSES)


def broken(walk: Walk, tally: Tally) -> Violation | None:
    """Walk from the beginning, and return the promise that breaks, if any."""
    world = world_of(walk.services, walk.features)
    if world is None or world.trees.load(world.trees.first()) is None:
        return None
    tally.walks += 1
    gc_before = gc.get_threshold()
    gc.set_threshold(*SELDOM)  # nearly all that a walk makes is frozen, and in no ring
    with tempfile.TemporaryDirectory(dir=TMPFS if Path(TMPFS).is_dir() else None) as folder:
        robot = WalkRobot(world, Path(folder))
        try:
            _live(world, robot, walk.steps, tally)
        except Violation as found:
            return found
        except AssertionError as found:
            return Violation("the plan keeps its rules", str(found))
        finally:
            robot.journal.database.close()
            gc.set_threshold(*gc_before)
    return None


def _live(world: WalkWorld, robot: WalkRobot, steps: Steps, tally: Tally) -> None:
    watch = Watch(robot, check, sparing=True)

    def passed() -> None:
        tally.passes += 1
        watch.passed()
        robot.journal.note()

    robot.pass_until(1.0, partial(passed))
    for step, pause in steps:
        if not take(world, robot, step):
            continue
        tally.steps += 1
        if pause == REST:
            rest(robot, watch, passed)
        elif pause:
            robot.pass_until(robot.now + pause, partial(passed))
    rest(robot, watch, passed)


def rest(robot: WalkRobot, watch: Watch, passed: Callable[[], None]) -> None:
    """Let nothing happen for a long time, and judge the rest."""
    robot.patience = PATIENCE
    passes = robot.pass_until(float(math.ceil(robot.now + REST)), partial(passed))
    if passes > MOST_PASSES:
        raise Violation("it converges in bounded passes", f"{passes} passes")
    check("rest", watch)
    robot.patience = 0.0
    robot.spoilt.clear()  # no call came that could go wrong


# -- a violation made small ----------------------------------------------------------------------------------------


def shrink(walk: Walk, name: str, seconds: float = 120.0) -> Walk:
    """Return a smaller walk that breaks the same promise: fewer steps, then fewer features and services, then shorter
    pauses."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        smaller = next((one for one in _smaller(walk) if time.monotonic() < until and _breaks(one, name)), None)
        if smaller is None:
            return walk
        walk = smaller
    return walk


def _breaks(walk: Walk, name: str) -> bool:
    found = broken(walk, Tally())
    return found is not None and found.name == name


def _smaller(walk: Walk) -> Iterator[Walk]:
    steps, size = walk.steps, len(walk.steps) // 2
    while size:
        for start in range(0, len(steps), size):
            yield Walk(walk.services, walk.features, (*steps[:start], *steps[start + size :]))
        size //= 2
    last = walk.services - 1
    if last and all(str(last) not in f[1:] for f in walk.features) and all(last not in s[1:] for s, _ in steps):
        yield Walk(last, walk.features, steps)
    for index in range(len(walk.features)):
        yield Walk(walk.services, (*walk.features[:index], *walk.features[index + 1 :]), steps)
    for index, (step, pause) in enumerate(steps):
        if pause == REST or 0.0 < pause < 6.0:
            after = 6.0 if pause == REST else 0.0
            yield Walk(walk.services, walk.features, (*steps[:index], (step, after), *steps[index + 1 :]))


def save(walk: Walk, found: Violation) -> Path:
    """Write a case, named after the promise that it broke."""
    name = found.name.replace(" ", "_")
    number = next(n for n in range(1, 1000) if not (CASES / f"{name}_{n}.json").exists())
    path = CASES / f"{name}_{number}.json"
    steps = [json.dumps([*step, pause]) for step, pause in walk.steps]
    features = json.dumps(walk.features)
    lines = ",\n  ".join(steps)
    head = f'{{\n "broke": {json.dumps(str(found)[:300])},\n "services": {walk.services},\n "features": {features},'
    path.write_text(f'{head}\n "steps": [\n  {lines}\n ]\n}}\n')
    return path


def load(path: Path) -> Walk:
    """Read a case."""
    found = json.loads(path.read_text())
    steps = tuple((tuple(s[:-1]), s[-1]) for s in found["steps"])
    return Walk(found["services"], tuple(tuple(f) for f in found["features"]), steps)
