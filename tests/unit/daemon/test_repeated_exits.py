"""The log of a service that ends again and again: its first exits, then fewer and fewer; the journal has all."""

from __future__ import annotations

import re

from robots import write_tree

from rorg.core.masking import Masker
from rorg.core.memory import Memory
from rorg.daemon.recorder import Recorder
from rorg.daemon.reporter import OFTEN, Reporter
from rorg.manifest.load import load_or_raise
from rorg.store.state_dir import StateDir
from rorg.tools.sim.robot import SimRobot


def test_exits_are_told_ever_more_seldom_and_all_are_in_the_journal(tmp_path):
    robot = SimRobot(load_or_raise(write_tree(tmp_path / "tree", {"arm": {"always_on": True}})))
    robot.faults.crash_after = {"arm": 1.0}
    lines: list[str] = []
    recorder = Recorder(StateDir(tmp_path / "state").prepare(), lines.append, lambda: "2026-01-01T00:00:00Z", Masker())
    reporter = Reporter(recorder, robot.engine, lambda: robot.now, Memory())

    def exits(least: int) -> bool:
        reporter._services(robot.decision)
        return robot.memory.of("arm").crashes >= least

    robot.run(lambda _: exits(40), 3600)
    told = [int(number) for line in lines for number in re.findall(r"unexpected exit (\d+)", line)]
    assert told == [*range(1, OFTEN + 1), 16, 32]
    assert sum("goes on like this" in line for line in lines) == 3  # at 8, 16 and 32
    kept = [e["crashes"] for e in recorder.journal.after(0, 10_000) if e["kind"] == "crashed"]
    assert kept == [*range(1, 41)]

    robot.faults.crash_after = {}
    robot.at(robot.now + 300, lambda: None)  # nothing else leads to a pass
    robot.run(lambda _: exits(0) and robot.memory.of("arm").exits == 0, 600)
    count = robot.memory.of("arm").crashes
    robot.engine.kill(robot.engine.list()[0].id)
    robot.run(lambda _: exits(count + 1), 600)
    assert f"unexpected exit {count + 1}" in lines[-1], "after it ran well for a while, the next exit is news"
    recorder.history.close()
