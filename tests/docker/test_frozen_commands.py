"""Every command ends in time and names the culprit: a frozen engine, a frozen rorg, or the socket of a killed one."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import commands
import pytest
from command_samples import SAMPLES, Line
from common import wait_for
from frozen import frozen
from robots import Daemon, RealRobot, write_tree
from rorg_client import Client

from rorg.cli.commands import COMMANDS
from rorg.errors import Exit

pytestmark = pytest.mark.docker
LIMIT = 3.0
"""Seconds for which a command may wait for somebody who does not answer."""
SLACK = 8.0
"""A command may take LIMIT, and so many times what `rorg validate` takes at the same time on this machine. That one
waits for nobody, so it tells what the start and the work of a command cost on a machine that does much else."""
BESIDE = 4
"""It runs once for so many commands: how busy the machine is changes from one second to the next."""
AT_ONCE = 3
"""Commands that run at the same time, most of which only wait."""


LINES = {name: sample.hang for name, sample in SAMPLES.items()}
TRACE = """apiVersion: rorg/v1
kind: Trace
metadata: {name: day}
spec:
  duration: 1m
  states: {rest: [], work: [arm]}
  events: [{at: 0s, state: rest}, {at: 10s, state: work}]
"""
ROBOTS_OF_THEIR_OWN = ("demo", "emulate")
"""They have nothing to do with the rorg that runs here, and take minutes on an engine that answers."""


class Ended(NamedTuple):
    code: int
    out: str
    err: str
    seconds: float


class Robot:
    """A `rorg run` on Docker, and lines of commands about it."""

    def __init__(self, robot: RealRobot, folder: Path) -> None:
        write_tree(robot.tree, {"arm": {"always_on": True}, "lidar": {}})
        self.robot, self.daemon, self.new = robot, Daemon(robot), folder / "new"
        self.new.mkdir()
        (self.new / "manifests").symlink_to(robot.tree)
        unit, trace = folder / "a.service", folder / "trace.yaml"
        unit.write_text("[Service]\nExecStart=/bin/true\n")
        trace.write_text(TRACE)
        self.places = {"new": self.new, "tree": robot.tree, "unit": unit, "trace": trace}
        self.environment = {"RORG_STATE_DIR": str(robot.state.path), "RORG_ENGINE": "docker", "EDITOR": "true"}

    def start(self) -> None:
        self.daemon.start()
        wait_for(self.daemon.settled, 60)
        client = Client(self.robot.socket(), patience=60.0)
        wait_for(lambda: client.service("arm")["health"] == "Healthy", 60)

    def ends(self, words: str) -> Ended:
        began = time.monotonic()
        line = words.format(**self.places).split()
        try:
            done = commands.run(line, {**os.environ, **self.environment}, self.new, 60)
        except subprocess.TimeoutExpired:
            return Ended(-1, "", f"{words}: still not ended after 60 s", 60.0)
        return Ended(done.returncode, done.stdout, done.stderr, time.monotonic() - began)

    def all_end(self, names: tuple[str, ...]) -> Iterator[tuple[str, Ended]]:
        """Those commands, some at a time, with what each may take; `down` is the last one, since it leaves nothing."""
        ordinary = [n for n in names if n != "down"]
        with ThreadPoolExecutor(AT_ONCE) as pool:
            found, usual = [], []
            for index, name in enumerate(ordinary):
                if index % BESIDE == 0:
                    usual.append(pool.submit(self.ends, LINES["validate"].words))
                found.append((name, pool.submit(self.ends, LINES[name].words)))
        yield from ((name, ended.result()) for name, ended in found)
        yield "down", self.ends(LINES["down"].words)
        self.usual = max(ended.result().seconds for ended in usual)

    def check(self, names: tuple[str, ...], named: str, concerns: Callable[[Line], bool]) -> None:
        """All of them end in time, none by a bug, and those that it concerns say `named` in their first line."""
        wrong, slow = [], {}
        for name, ended in self.all_end(names):
            said = ended.err.strip().partition("\n")[0] or ended.out  # of checks, which are a table
            if ended.code in (-1, int(Exit.INTERNAL)) or "internal error" in ended.err:
                wrong.append(f"{name}: exit {ended.code}: {ended.err}")
            elif concerns(LINES[name]) and named not in said:
                wrong.append(f"{name}: exit {ended.code} without '{named}' in its first line: {ended.err}{ended.out}")
            slow[name] = ended.seconds
        most = LIMIT + SLACK * self.usual
        wrong += [f"{name}: {seconds:.1f} s of {most:.1f} s" for name, seconds in slow.items() if seconds > most]
        assert not wrong, "\n".join(wrong)


@contextmanager
def stopped(pid: int) -> Iterator[None]:
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)


@pytest.fixture
def robot(docker_robot, tmp_path):
    return Robot(docker_robot, tmp_path)


def others(*left_out: str) -> tuple[str, ...]:
    return tuple(name for name in COMMANDS if name not in left_out)


def test_every_command_has_a_line_here():
    assert set(LINES) == set(COMMANDS)


def test_on_a_frozen_engine_every_command_ends_and_names_it(robot, dockerd):
    robot.start()
    client = Client(robot.robot.socket())
    with frozen(dockerd):
        wait_for(lambda: client.call("GET", "/v1/engine")["silent_since"], 60)
        robot.check(others(), dockerd.host, lambda line: line.engine)


def test_without_an_rorg_too(robot, dockerd):
    """What is only written down for the next rorg needs no engine."""
    with frozen(dockerd):
        robot.check(others("run"), dockerd.host, lambda line: line.words in ("get", "diff", "why arm", "logs arm"))


def test_on_a_frozen_rorg_every_command_ends_and_names_it(robot):
    robot.start()
    with stopped(robot.daemon.process.pid):
        robot.check(others(*ROBOTS_OF_THEIR_OWN), str(robot.daemon.process.pid), lambda line: line.rorg)
    wait_for(robot.daemon.settled, 60)


def test_the_socket_of_a_killed_rorg_counts_as_none(robot):
    """Also where it is all that the environment names."""
    robot.start()
    robot.daemon.kill()
    assert os.path.exists(robot.robot.socket())
    robot.environment = {"RORG_SOCKET": robot.robot.socket(), "RORG_ENGINE": "docker", "EDITOR": "true"}
    ended = dict(robot.all_end(others("run", *ROBOTS_OF_THEIR_OWN)))
    wrong = [f"{n}: {e.err}" for n, e in ended.items() if "refused" in e.err.lower() or e.code == int(Exit.INTERNAL)]
    assert not wrong, "\n".join(wrong)
    assert (ended["get"].code, "arm" in ended["get"].out) == (0, True)
    assert ended["down"].code == 0, ended["down"].err
    assert "the robot is down" in ended["down"].err
    assert not robot.robot.containers()
