"""Emulates a trace: plays it on a real engine with stand-ins instead of the programs, alternately with and without
rorg."""

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
"""Names of the two runs of a pair, in order."""
PATIENCE = 300.0
"""Seconds until everything that runs at the beginning is ready."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment:
    """What to emulate."""

    root: Path
    """Directory of the manifests."""
    robot: str
    """The robot whose overlay applies; empty for none."""
    catalog: Catalog
    """The robot that the manifests declare."""
    images: Mapping[str, Image]
    """The image of the stand-ins, and its bases."""
    engine: str
    trace: Trace
    """The trace as it is played, after compression."""
    share: Share

    def stand_ins(self, prefix: str = PREFIX) -> Catalog:
        """The robot that runs. `prefix`: of its containers' names."""
        return stand_ins(self.catalog, self.images, self.share, prefix)


def emulate(experiment: Experiment, pairs: int, say: Callable[[str], None]) -> Generator[EmulatedRun, None, None]:
    """Plays the trace `pairs` times with everything on and with rorg, and yields each run when it is over. Closing the
    generator cleans up. `say` receives progress messages. Raises Invalid if the engine cannot be measured,
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
    """Discards a message."""


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
        adapt=lambda _: catalog,  # edits of the manifests have no effect meanwhile
    )
    robot.build(catalog, _quiet)
    if name == ALL_ON:
        robot.requests.change(lambda asked: asked.put(everything(catalog, experiment.trace)))
    loop = robot.run(tree, _quiet, "rorg emulate")
    robot.wait("the start", lambda view: len(view["services"]) == len(catalog.services), PATIENCE)
    robot.settle("everything to be ready", PATIENCE)
    say(f"{len(robot.active())} services run; the trace takes {experiment.trace.duration:.0f} s")
    return Player(robot, loop, experiment.trace).play(name)
