"""Scenes in which something is killed: a program of the robot, and rorg itself."""

from __future__ import annotations

import time

import psutil

from rorg.cli.demo.stage import Stage

VICTIM = "navigation"


def crash(stage: Stage) -> None:
    """A program crashes, and rorg starts it again."""
    stage.show.scene(f"On the way, {VICTIM} crashes, and then rorg itself is killed")
    run, began = stage.now.runs()[VICTIM], time.monotonic()
    stage.run(_crash_command(stage))
    stage.robot.wait(
        f"the next run of {VICTIM}",
        lambda view: (
            view["services"].get(VICTIM, {}).get("incarnation") not in (None, "", run)
            and view["services"][VICTIM]["health"] == "Healthy"
        ),
    )
    seconds = time.monotonic() - began
    stage.settle("the crash")
    stage.show.line(f"{VICTIM} is ready again after {seconds:.1f} s; {stage.others(VICTIM)}")


def _crash_command(stage: Stage) -> str:
    """The command that crashes the program. A container may run on another machine or under other pids, so the signal
    goes through the engine; at SIGUSR1 a stand-in exits with 1."""
    if stage.robot.engine.capabilities.images:
        return f"rorg exec {VICTIM} -- sh -c 'kill -USR1 1'"
    program, *_ = psutil.Process(stage.robot.container(VICTIM).pid).children()
    return f"kill -9 {program.pid}"


def kill_rorg(stage: Stage) -> None:
    """rorg is killed; the services go on, and the next rorg takes over."""
    assert stage.robot.server is not None
    stage.run(f"kill -9 {stage.robot.server.pid}")
    stage.robot.server.wait()
    alive = sum(container.state == "running" for container in stage.robot.containers())
    stage.show.line(f"{alive} services run on without rorg")
    seconds = stage.serve()
    stage.show.line(f"in control again after {seconds:.1f} s; {stage.others()}")
