"""Puts the parts together: which engine, which state directory, which clock."""

from __future__ import annotations

import os
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from rorg.daemon.loop import Loop
from rorg.daemon.reporter import Reporter
from rorg.daemon.tree import Tree
from rorg.engines import ENGINES
from rorg.engines.protocol import Engine
from rorg.errors import Invalid
from rorg.model.units import stamp
from rorg.store.state_dir import StateDir

if TYPE_CHECKING:
    from rorg.daemon.door import Door


def make_engine(name: str, state: StateDir) -> Engine:
    """An engine by name, for the containers of this state directory's instance."""
    owner = state.instance(lambda: uuid.uuid4().hex)
    if name == "docker":
        from rorg.engines.docker import DockerEngine

        return DockerEngine(owner)
    if name == "process":
        from rorg.engines.process import ProcessEngine

        return ProcessEngine(owner, state.path / "process")
    raise Invalid(f"use the engine '{name}'", "there is none of that name", " or ".join(ENGINES))


def wall_clock() -> str:
    """Now, ISO 8601 in UTC, as the engine writes times."""
    return stamp(time.time())


def booted_at() -> str:
    """When this machine booted, ISO 8601 in UTC."""
    with open("/proc/stat", encoding="ascii") as file:
        seconds = next(int(line.split()[1]) for line in file if line.startswith("btime "))
    return stamp(seconds)


def make_loop(root: Path, state: StateDir, engine: Engine, say: Callable[[str], None]) -> Loop:
    """A loop over the real clock, ready to run. The caller holds the lock of the state directory."""
    owner = state.instance(lambda: uuid.uuid4().hex)
    about = {"pid": os.getpid(), "engine_name": engine.name, "instance": owner}
    reporter = Reporter(state, say, wall_clock, time.monotonic, about, engine.capabilities.ignored_options)
    return Loop(Tree(root.resolve(), str(state.run)), state, engine, reporter, owner, time.monotonic, booted_at())


def make_door(loop: Loop, state: StateDir, group: str) -> Door:
    """The API of a loop, on sockets below the state's run directory."""
    from rorg.daemon.door import Door
    from rorg.daemon.robot import Robot

    return Door(Robot(loop, loop.reporter.about), state.run, group)
