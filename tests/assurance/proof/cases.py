"""Plays a scenario, with a kill at one of its points or without, and checks what came of it."""

from __future__ import annotations

import contextlib
import random
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from proof.acts import Acts as World
from proof.effects import ORDERED, SIDES
from proof.promises import Story, violations
from proof.world import Died

from rorg.client import Error, Unreachable

Step = Callable[[World], Any]
MOST_DEATHS = 5
PATIENCE = 20.0
JOURNAL = "sqlite"
"""Effects that a loss of power leaves as they are: the journal's promise is another one."""


@dataclass(frozen=True)
class Scenario:
    """`given` makes the world before any kill; each of `steps` is repeated if rorg dies in it, as a client would."""

    name: str
    given: Step
    steps: tuple[Step, ...]
    ends: bool = False
    """rorg ends by itself at the end."""
    command: bool = False
    """A command is killed, and not the rorg that runs."""


@dataclass
class Result:
    """Of a case."""

    scenario: str
    point: int = 0
    side: str = ""
    reached: bool = True
    violations: list[str] = field(default_factory=list)
    log: str = ""
    seconds: float = 0.0

    def __str__(self) -> str:
        again = f"RORG_PROOF_SCENARIO={self.scenario} RORG_PROOF_POINT={self.point}:{self.side}"
        return "\n".join([f"{again}", *self.violations, self.log])


class Player:
    """Of one scenario: plays it once without a kill, then at any point."""

    def __init__(self, scenario: Scenario, folder: Path, make: Callable[[Path], World] = World) -> None:
        self.scenario = scenario
        self.twice: random.Random | None = None
        folder.mkdir(parents=True, exist_ok=True)
        self.world = make(folder)
        try:
            self.world.prepare(scenario.given)
            self.reference, self.effects = self._reference()
        except BaseException:
            self.close()
            raise

    def _reference(self) -> tuple[Story, list[str]]:
        self.world.restore()
        self.world.start()
        for step in self.scenario.steps:
            step(self.world)
        end = self._end()
        effects = self.world.effects(self.scenario.command)
        self.outcomes = self.world.outcomes(self.scenario.command)
        self.world.kill()
        self.world.check_requests()
        story = self.world.story(end, None)
        broken = violations(story)
        assert not broken, f"{self.scenario.name} without a kill: {broken}\n{self.world.engine.log}"
        return story, effects

    def points(self) -> Iterator[tuple[int, str]]:
        for number, what in enumerate(self.effects, 1):
            for side in SIDES:
                if side != "power" or JOURNAL not in what:
                    yield number, side

    def reordered(self) -> Iterator[tuple[int, str]]:
        """Every outcome of a loss of power after each effect."""
        for number, what in enumerate(self.effects, 1):
            for outcome in range(self.outcomes.get(number, 0) if JOURNAL not in what else 0):
                yield number, f"{ORDERED}{outcome}"

    def play(self, point: int, side: str, show: bool = False) -> Result:
        """One case. With `twice`, the rorg after the kill is killed too, at a point that it draws."""
        began, world = time.monotonic(), self.world
        world.restore()
        world.start(*((0, "after") if self.scenario.command else (point, side)))
        world.aim = point, side
        end: dict[str, Any] = {}
        try:
            for step in self.scenario.steps:
                self._insist(step)
            reached = bool(world.deaths)
            if not reached:
                with contextlib.suppress(Died, Unreachable):
                    self._end()
            reached = reached or not world.alive()
            self._killed()
            end = self._insist(lambda _: self._end())
        except (AssertionError, Error, RuntimeError) as error:
            reached = world.deaths > 0
            world.engine.log.add("late", text=f"{type(error).__name__}: {error}; {world.states()}")
        world.kill()
        world.check_requests()
        found = violations(world.story(end, self.reference))
        result = Result(self.scenario.name, point, side, reached, found, seconds=time.monotonic() - began)
        if found or show:
            log = (world.folder / "rorg.log").read_bytes()[-3000:].decode(errors="replace")
            result.log = f"{world.engine.log}\n{log}"
        return result

    def _insist(self, step: Step) -> Any:
        """Do a step again with the next rorg, whenever this one dies in it."""
        while True:
            try:
                return step(self.world)
            except (Died, Unreachable):
                self._recover()

    def _killed(self) -> None:
        """Kill it now if it has not been yet, and go on."""
        if not self.world.deaths and not self.scenario.command:
            self.world.kill()
            self._recover()

    def _recover(self) -> None:
        world, of_command = self.world, self.scenario.command
        world.deaths += 1
        assert world.process is not None
        code = -9 if of_command else world.process.wait(30)
        world.engine.log.add("died", text=f"exit code {code}, after {(world.effects(of_command) or ['nothing'])[-1]}")
        if world.deaths > MOST_DEATHS:
            raise RuntimeError("rorg dies again and again")
        world.check_requests()
        world.check_written(self.reference.end["written"])
        if of_command:
            return
        if self.twice and world.deaths == 1:
            world.start(self.twice.randint(1, len(self.effects)), self.twice.choice(SIDES))
        else:
            world.start()

    def _end(self) -> dict[str, Any]:
        if self.scenario.command:  # the next rorg clears up what a killed command left in the state directory
            self.world.kill()
            self.world.start()
        if not self.scenario.ends:
            return self.world.rest()
        self.world.when_gone()
        return self.world.end({})

    def close(self) -> None:
        self.world.close()
