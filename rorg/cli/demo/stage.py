"""What every scene uses: it runs commands on the robot, prints what came of them, and keeps what the summary needs."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from rorg.cli.demo.robot import DemoRobot
from rorg.cli.demo.show import Show
from rorg.cli.demo.snapshot import Snapshot
from rorg.model.units import format_memory
from rorg.store.state_dir import read_json
from rorg.tools.sim.throwaway import EMPTY

MEASURED = 1.5
"""Seconds for which CPU is measured. A stand-in works and rests ten times a second, so this is long enough."""


class Use(NamedTuple):
    """What all services use together: cores, and bytes of memory."""

    cpu: float
    memory: float

    def __str__(self) -> str:
        return f"{self.cpu:.2f} cores, {format_memory(self.memory)}"


class Stage:
    """The robot, the show, and what the robot was like at the last two looks."""

    def __init__(self, robot: DemoRobot, show: Show) -> None:
        self.robot, self.show = robot, show
        self.before = self.now = Snapshot()
        self.uses: list[Use] = []
        """One for each action of the robot's work."""
        self.moments: dict[str, Snapshot] = {}
        """Title -> what ran then, for the picture."""

    def run(self, line: str) -> float:
        """Run a command, and return its seconds."""
        self.show.command(line)
        began = time.monotonic()
        self.robot.shell(line)
        return time.monotonic() - began

    def serve(self) -> float:
        """Start rorg, and return the seconds until the robot is at rest."""
        line = f"rorg run manifests --engine {self.robot.engine.name}"
        self.show.command(line)
        began = time.monotonic()
        self.robot.serve(line)
        self.settle("the start")
        return time.monotonic() - began

    def settle(self, what: str) -> None:
        """Wait until the robot is at rest, and look at it."""
        self.look_at(self.robot.settle(what))

    def look_at(self, view: Mapping[str, Any]) -> None:
        """Remember this status as the present one."""
        self.before, self.now = self.now, Snapshot.of(view)
        self.print_actions()

    def print_actions(self) -> None:
        """Print what rorg did meanwhile, if that was asked for."""
        for line in self.robot.new_lines():
            self.show.action(line)

    def published(self) -> Snapshot:
        """What rorg published last, at no cost to it, for the live table."""
        return Snapshot.of(read_json(self.robot.state.status) or EMPTY)

    def print_changes(self, names: Sequence[str]) -> None:
        """Print what happened to those of these services that changed, and why."""
        changes = {change.service: change for change in self.now.changes(self.before)}
        width = max(map(len, names), default=0)
        for change in filter(None, map(changes.get, names)):
            self.show.line(f"{change.verb:<8} {change.service:<{width}}  {change.why or 'no longer wanted'}")

    def measure(self) -> Use:
        """Measure what all services use, while people look."""
        first, began = self.robot.usage(), time.monotonic()
        self.show.look(MEASURED)
        last, seconds = self.robot.usage(), time.monotonic() - began
        cpu = sum(max(0.0, use.cpu - first[name].cpu) for name, use in last.items() if name in first) / seconds
        return Use(cpu, sum(use.memory for use in last.values()))

    def others(self, *apart_from: str) -> str:
        """Say whether the services that ran at the last look, apart from these, still run as they did."""
        before, now = self.before.runs(), self.now.runs()
        touched = sorted(name for name, run in before.items() if now.get(name) != run and name not in apart_from)
        if touched:
            return f"also restarted or ended: {', '.join(touched)}"
        return f"{len(before.keys() - {*apart_from})} {'others' if apart_from else 'services'} ran on"
