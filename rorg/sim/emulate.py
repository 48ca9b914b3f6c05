"""Emulation: a trace on a real engine with stand-ins in place of programs, with and without rorg, in alternating
runs."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from pathlib import Path

from rorg.daemon.tree import Tree
from rorg.errors import Invalid
from rorg.model.catalog import Catalog, Image
from rorg.model.trace import Trace
from rorg.sim.player import EmulatedRun, Player
from rorg.sim.simulate import everything
from rorg.sim.standins import Share, stand_ins
from rorg.sim.throwaway import ThrowawayRobot

PREFIX = "rorg-emulate-"
ALL_ON, RORG = "all-on", "rorg"
"""Names of the two runs of a pair, in their order."""
PATIENCE = 300.0
"""Seconds until all that runs at the beginning is ready."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment:
    """What is run."""

    root: Path
    """The manifests."""
    robot: str
    """Whose overlay counts; empty for the base alone."""
    catalog: Catalog
    """What they say."""
    images: Mapping[str, Image]
    """What the image of the stand-ins is built from, it included."""
    engine: str
    trace: Trace
    """As it is played: compressed."""
    share: Share

    def stand_ins(self, prefix: str = PREFIX) -> Catalog:
        """The robot that is run: the names of its containers begin so."""
        return stand_ins(self.catalog, self.images, self.share, prefix)


def emulate(experiment: Experiment, pairs: int, say: Callable[[str], None]) -> Generator[EmulatedRun, None, None]:
    """All on and rorg in turns, `pairs` times: each run once it is over. A caller that has enough closes it, and
    nothing is left behind. `say` hears how it goes on. Raises Invalid where the engine cannot be measured,
    Unreachable, and NotReady."""
    keeper = ThrowawayRobot(experiment.engine, PREFIX)
    try:
        if not keeper.engine.local:
            why = "it is on another machine, whose control groups cannot be read"
            raise Invalid("measure on this engine", why, "an engine of this machine")
        say(f"on the {experiment.engine} engine {keeper.engine.ping()}")
        keeper.build(experiment.stand_ins(), say)
        for number in range(1, pairs + 1):
            for name in (ALL_ON, RORG):
                say(f"pair {number} of {pairs}, {name}")
                yield _run(experiment, name, say)
    finally:
        keeper.clean_up(say)


def _quiet(_: str) -> None:
    """Nobody wants to hear it."""


def _run(experiment: Experiment, name: str, say: Callable[[str], None]) -> EmulatedRun:
    robot = ThrowawayRobot(experiment.engine, PREFIX)
    try:
        return _played(experiment, robot, name, say)
    finally:
        robot.clean_up(say)


def _played(experiment: Experiment, robot: ThrowawayRobot, name: str, say: Callable[[str], None]) -> EmulatedRun:
    catalog = experiment.stand_ins(f"{robot.folder.name}-")
    tree = Tree(
        experiment.root.resolve(),
        str(robot.state.run),
        references=robot.references,
        named=experiment.robot,
        adapt=lambda _: catalog,  # whoever edits the manifests meanwhile changes nothing
    )
    robot.build(catalog, _quiet)
    if name == ALL_ON:
        robot.requests.change(lambda asked: asked.put(everything(catalog, experiment.trace)))
    loop = robot.run(tree, _quiet, "rorg emulate")
    robot.wait("the start", lambda view: len(view["services"]) == len(catalog.services), PATIENCE)
    robot.settle("everything to be ready", PATIENCE)
    say(f"{len(robot.active())} services run; the trace takes {experiment.trace.duration:.0f} s")
    return Player(robot, loop, experiment.trace).play(name)
