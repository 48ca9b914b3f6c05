"""The scenes of the demo in order: the robot's work as in figure 4 of the paper, accidents, updates, and a
comparison."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from rorg.cli.demo import accidents, updates
from rorg.cli.demo.picture import Bar, picture
from rorg.cli.demo.robot import DemoRobot
from rorg.cli.demo.show import Show
from rorg.cli.demo.stage import Stage, Use
from rorg.images.order import LABEL_BUILDER
from rorg.model.units import format_memory

Scene = Callable[[Stage], None]
BUSY = 4.0
"""Load for each CPU at which the services did not get the CPU that they would use. The demo alone makes less than 2."""


class Action(NamedTuple):
    """A step of the robot's work: the group that `behavioral` requests instead of the previous one, and the services
    whose change explains what rorg does. Without a title it continues the scene."""

    title: str
    group: str
    shown: tuple[str, ...] = ()
    pictured: str = ""
    """Its title in the picture."""

    @property
    def line(self) -> str:
        return f"rorg request {self.group} --as behavioral --id action --wait"


STANDBY = Action("2 It looks for visitors", "standby", ("openface_client",), "Standby: looking for visitors")
CHAT = Action("3 It talks with one", "chat", ("gcloud_speech_action_server",))
TOUR = Action(
    "4 It guides a tour",
    "tour",
    ("navigation", "cartographer_localization", "openface_server"),
    "Tour: driving, talking, looking back",
)
DRIVE_BACK = Action("5 It drives back, and looks for visitors again", "drive_back")
STANDBY_AGAIN = Action("", "standby", ("openface_server", "cartographer_localization"))


def start(stage: Stage) -> None:
    """rorg starts what is always on; then the developer makes the robot autonomous."""
    stage.show.scene("1 The robot starts; a developer starts `behavioral`, which decides what to do")
    seconds = stage.serve()
    stage.show.line(f"{stage.now.counts()}; ready after {seconds:.1f} s")
    _work(stage, "rorg request behavioral --id autonomy --wait")


def act(action: Action) -> Scene:
    """Return the scene of an action."""

    def scene(stage: Stage) -> None:
        if action.title:
            stage.show.scene(action.title)
        _work(stage, action.line)
        stage.print_changes(action.shown)
        if action.pictured:
            stage.moments[action.pictured] = stage.now

    return scene


def _work(stage: Stage, line: str) -> None:
    """Run a command that begins an action, and measure what the action uses."""
    seconds = stage.run(line)
    stage.settle(f"what follows `{line}`")
    use = stage.measure()
    stage.uses.append(use)
    stage.show.line(f"{stage.now.counts()}; ready after {seconds:.1f} s; {use}")


def compare(stage: Stage) -> None:
    """Everything runs, as on robots without rorg; then the summary."""
    stage.show.scene("Everything on, as on robots without rorg")
    on_demand = stage.now
    stage.run("rorg request everything --wait")
    stage.settle("everything")
    everything = stage.measure()
    stage.show.line(f"{stage.now.counts()}; {everything}")
    mean = Use(
        sum(use.cpu for use in stage.uses) / len(stage.uses), sum(use.memory for use in stage.uses) / len(stage.uses)
    )
    bars = [
        Bar("CPU", everything.cpu, mean.cpu, "{:.2f} cores".format),
        Bar("memory", everything.memory, mean.memory, format_memory),
    ]
    stage.show.scene(f"Summary, measured now{_busy()}; stand-in loads are synthetic")
    for bar in bars:
        for line in bar.lines():
            stage.show.line(line)
    stage.show.line(
        f"{'idle':<7} {len(on_demand.names('paused'))} paused, which keep their memory and resume; "
        f"{len(on_demand.names('stopped'))} stopped"
    )
    if stage.show.svg:
        Path(stage.show.svg).write_text(picture(stage.moments, bars), encoding="utf-8")


def _busy() -> str:
    """Words that warn of CPU figures that other programs made too small; empty if they did not."""
    load = os.getloadavg()[0]
    return f" on a busy machine (load {load:.0f})" if load > BUSY * (os.cpu_count() or 1) else ""


SCENES: tuple[Scene, ...] = (
    start,
    act(STANDBY),
    act(CHAT),
    act(TOUR),
    accidents.crash,
    accidents.kill_rorg,
    act(DRIVE_BACK),
    act(STANDBY_AGAIN),
    updates.typing_mistake,
    updates.bad_update,
    compare,
)


def prepare(robot: DemoRobot, show: Show) -> None:
    """Make the robot's repository and images."""
    catalog = robot.set_up()
    began = time.monotonic()
    robot.build(catalog, show.progress)
    built = f"images built in {time.monotonic() - began:.0f} s; " if robot.engine.capabilities.images else ""
    count = sum(not service.meta for service in catalog.services.values())
    show.line(f"{built}{count} stand-in programs use {robot.scale:.0%} of what they declare")
    if ignored := robot.ignored_options(catalog):
        show.line(f"the engine ignores {', '.join(ignored)}")


def play(robot: DemoRobot, show: Show, keep: bool) -> None:
    """Play the demo from begin to end. With `keep`, leave the robot on a tour."""
    prepare(robot, show)
    stage = Stage(robot, show)
    show.open(stage.published)
    try:
        for scene in SCENES:
            scene(stage)
    finally:
        stage.print_actions()
    if keep:
        robot.shell("rorg release everything --yes")
        robot.shell(TOUR.line)
    show.close()
    show.scene("Next")
    for line in _kept(robot) if keep else NOT_KEPT:
        show.copied(line)


NOT_KEPT = (
    "rorg demo --keep   keeps it running, for `rorg why navigation` and `rorg ui`",
    "rorg init robot    begins a robot of your own",
)


def _kept(robot: DemoRobot) -> list[str]:
    """Return the commands that look at the kept robot, and those that remove it."""
    images = f"docker image prune --all --filter label={LABEL_BUILDER}={robot.engine.owner}"
    return [
        f"export RORG_STATE_DIR={robot.state.path}",
        "rorg get              what runs on this robot, which is on a tour",
        "rorg why navigation   who requested it",
        "rorg ui               the same in a browser",
        f"rorg down --yes && rm -r {robot.folder}",
        *([images] if robot.engine.capabilities.images else []),
    ]
