"""The table of speed: each row beside what it is compared with, in turn, with its goal: `make bench`.

COMPOSE names a binary of Docker Compose 2; without it the rows that need it are left out.
"""

from __future__ import annotations

import json
import os
import re
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest
from common import BASE_IMAGE, wait_for
from robots import WORK, write_tree
from rorg_process import RorgProcess
from rows import Row, Side, Table, alternating, milliseconds, states

COMPOSE = os.environ.get("COMPOSE", "")
RORG = [sys.executable, "-m", "rorg"]
# The environment of a test run may forbid .pyc files, which a command of every day has.
ENVIRONMENT = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
TABLE = Table()


def run(words: list[str], env: dict[str, str]) -> None:
    done = subprocess.run(words, env=env, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def bare() -> None:
    subprocess.run([sys.executable, "-c", ""], env=ENVIRONMENT, check=True)


def always_on(count: int) -> dict[str, dict]:
    return {f"s{n:03}": {"always_on": True} for n in range(count)}


def edit(tree: Path, number: int) -> None:
    """Changes one service that runs, so that it needs a new container."""
    path = tree / "services/s001.yaml"
    lines = [line for line in path.read_text().splitlines() if "container:" not in line]
    path.write_text("\n".join([*lines, f'  container: {{environment: {{NUMBER: "{number}"}}}}']) + "\n")


class Compose:
    """The same containers, by Compose."""

    def __init__(self, folder: Path, count: int, host: str) -> None:
        folder.mkdir()
        self.file, self.env = folder / "compose.json", {**ENVIRONMENT, "DOCKER_HOST": host}
        one = {"image": BASE_IMAGE, "command": WORK, "network_mode": "host", "init": True, "stop_grace_period": "1s"}
        self.services: dict[str, dict] = {name: dict(one) for name in always_on(count)}
        self.write()

    def write(self) -> None:
        self.file.write_text(json.dumps({"name": "bench", "services": self.services}))

    def up(self) -> None:
        run([COMPOSE, "-f", str(self.file), "up", "-d", "--quiet-pull"], self.env)

    def change(self, number: int) -> None:
        self.services["s001"]["environment"] = {"NUMBER": str(number)}
        self.write()

    def down(self) -> None:
        run([COMPOSE, "-f", str(self.file), "down", "-t", "0"], self.env)


@contextmanager
def running(robot: RorgProcess) -> Iterator[RorgProcess]:
    """`rorg run`, with an interpreter of its own, until the end of the block."""
    robot.start(env={**ENVIRONMENT, **({"DOCKER_HOST": robot.docker} if robot.docker else {})})
    try:
        wait_for(lambda: (robot.state / "run/rorg.sock").exists(), 60)
        yield robot
    finally:
        robot.close()


def environment(robot: RorgProcess) -> dict[str, str]:
    docker = {"DOCKER_HOST": robot.docker} if robot.docker else {}
    return {**ENVIRONMENT, "RORG_STATE_DIR": str(robot.state), "RORG_ENGINE": robot.engine, **docker}


def needs_compose() -> None:
    if not COMPOSE:
        pytest.skip("COMPOSE names no Docker Compose")


def counted(call: Callable[[int], object]) -> Callable[[], object]:
    """A call that gets a new number each time."""
    numbers = iter(range(1, 1000))
    return lambda: call(next(numbers))


# -- all services ----------------------------------------------------------------------------------------------


def test_all_from_nothing_alone(dockerd, tmp_path):
    needs_compose()
    robot = RorgProcess(tmp_path, always_on(41), docker=dockerd.host)
    env, compose = environment(robot), Compose(tmp_path / "compose", 41, dockerd.host)
    apply = [*RORG, "apply", str(robot.tree), "--yes", "--wait"]
    down = [*RORG, "down", "--yes"]
    ours, theirs = alternating(
        3,
        Side(lambda: run(apply, env), lambda: run(down, env), dockerd.host, running=41),
        Side(compose.up, compose.down, dockerd.host, running=41),
    )
    TABLE.add(Row("41 services from nothing, `apply` alone", ours, "ms", 1.3, theirs, "Compose"))


@pytest.mark.parametrize(("count", "goal"), [(41, 1.0), (200, 0.9)])
def test_all_from_nothing_before_a_running_rorg(dockerd, tmp_path, count, goal):
    needs_compose()
    left = {"left": {}}  # a tree of which nothing is left counts as a mistake: rorg removes nothing
    robot = RorgProcess(tmp_path, left, docker=dockerd.host)
    compose = Compose(tmp_path / "compose", count, dockerd.host)
    with running(robot):
        client = robot.client(timeout=60.0, patience=60.0)

        def declare() -> None:
            write_tree(robot.tree, {**left, **always_on(count)})
            wait_for(lambda: "s000" in {s["service"] for s in client.services()}, 60)
            client.wait(*always_on(count), timeout=300)

        wait_for(lambda: states(dockerd.host).total() == len(left), 60)
        ours, theirs = alternating(
            1 if count > 100 else 3,
            Side(declare, lambda: write_tree(robot.tree, left), dockerd.host, running=count),
            Side(compose.up, compose.down, dockerd.host, running=count),
        )
    TABLE.add(Row(f"{count} manifests put before a running rorg, until ready", ours, "ms", goal, theirs, "Compose"))


def test_nothing_and_one_changed(dockerd, tmp_path):
    needs_compose()
    robot = RorgProcess(tmp_path, always_on(41), docker=dockerd.host)
    env, compose = environment(robot), Compose(tmp_path / "compose", 41, dockerd.host)
    apply = [*RORG, "apply", str(robot.tree), "--yes", "--wait"]
    compose.up()
    run(apply, env)
    both: dict[str, Any] = {"host": dockerd.host, "running": 2 * 41}
    ours, theirs = alternating(7, Side(lambda: run(apply, env), **both), Side(compose.up, **both))
    TABLE.add(Row(f"nothing changed, `apply` alone (Compose {theirs:.0f} ms)", ours, "ms", 300))
    with running(robot):
        client = robot.client()
        client.wait(*always_on(41), timeout=60)
        ours = statistics.median(milliseconds(lambda: run([*RORG, "apply", "--yes", "--wait"], env)) for _ in range(9))
        TABLE.add(Row(f"nothing changed, `apply` through a loop (Compose {theirs:.0f} ms)", ours, "ms", 90))

        def change(number: int) -> None:
            old = client.service("s001")["container"]
            edit(robot.tree, number)
            wait_for(lambda: client.service("s001")["container"] != old, 60)
            client.wait("s001", timeout=60)

        def settle() -> None:
            wait_for(lambda: client.plan()["actions"] == [] and client.plan()["waitings"] == [], 60)

        def theirs_changed(number: int) -> None:
            compose.change(number)
            compose.up()

        ours, theirs = alternating(5, Side(counted(change), settle, **both), Side(counted(theirs_changed), **both))
        TABLE.add(Row("one manifest saved, until the new container is ready", ours, "ms", 1.2, theirs, "Compose"))
    compose.down()


# -- commands and calls ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def at_rest(tmp_path_factory):
    """41 services on the process engine, a quarter of which run."""
    specs = {f"s{n:03}": {"always_on": n % 4 == 1} for n in range(41)}
    with running(RorgProcess(tmp_path_factory.mktemp("rest"), specs)) as robot:
        robot.client().wait("s001", timeout=60)
        yield robot


@pytest.mark.parametrize("line", ["get", "diff", "why s001", "request s002 --id bench"])
def test_a_command_through_a_loop(at_rest, line):
    words, env = [*RORG, *line.split()], environment(at_rest)
    ours, theirs = alternating(15, Side(lambda: run(words, env)), Side(bare))
    TABLE.add(Row(f"`rorg {line.partition(' ')[0]}` through a loop (bare Python {theirs:.0f} ms)", ours, "ms", 55))


def test_calls_of_a_program(at_rest):
    client = at_rest.client()
    for what, call, goal in (
        ("status of 41 services from Python", client.services, 0.8),
        ("status of one service from Python", lambda: client.service("s001"), 0.3),
    ):
        call()
        TABLE.add(Row(what, statistics.median(milliseconds(call) for _ in range(200)), "ms", goal))


def test_validate_300(tmp_path):
    write_tree(tmp_path / "tree", {f"s{n:03}": {} for n in range(300)})
    words = [*RORG, "validate", str(tmp_path / "tree")]
    ours, theirs = alternating(7, Side(lambda: run(words, ENVIRONMENT)), Side(bare))
    TABLE.add(Row(f"`rorg validate`, 300 services (bare Python {theirs:.0f} ms)", ours, "ms", 400))


# -- at rest, and among crashes --------------------------------------------------------------------------------


def megabytes(process: psutil.Process) -> float:
    """PSS."""
    rollup = Path(f"/proc/{process.pid}/smaps_rollup").read_text()
    return int(re.search(r"^Pss:\s+(\d+)", rollup, re.MULTILINE)[1]) / 1024


def percent(process: psutil.Process, seconds: float) -> float:
    """CPU of a process over so many seconds, in hundredths of a core."""
    before, began = sum(process.cpu_times()[:2]), time.monotonic()
    time.sleep(seconds)
    return 100 * (sum(process.cpu_times()[:2]) - before) / (time.monotonic() - began)


@pytest.mark.parametrize(("count", "most"), [(41, 45), (200, 50)])
def test_at_rest(dockerd, tmp_path, count, most):
    specs = {f"s{n:03}": {"always_on": n % 4 == 1} for n in range(count)}
    with running(RorgProcess(tmp_path, specs, docker=dockerd.host)) as robot:
        robot.client(timeout=60.0).wait(*(n for n, s in specs.items() if s["always_on"]), timeout=120)
        wait_for(lambda: robot.client().plan()["actions"] == [], 60)
        process = psutil.Process(robot.process.pid)
        time.sleep(10)
        used = percent(process, 30)
        TABLE.add(Row(f"memory at rest, {count} services", megabytes(process), "MiB", most))
        TABLE.add(Row(f"CPU at rest, {count} services", used, "%", 0.1))


def test_300_that_crash(tmp_path):
    """They exit after a second; the policy starts them again, ever later."""
    specs = {f"s{n:03}": {"always_on": True, "command": ["sh", "-c", "sleep 1; exit 1"]} for n in range(300)}
    with running(RorgProcess(tmp_path, specs)) as robot:
        process = psutil.Process(robot.process.pid)
        client = robot.client(timeout=60.0)
        wait_for(lambda: sum(s["crashes"] > 3 for s in client.services()) > 200, 300)
        lines = (robot.folder / "rorg.log").read_bytes().count(b"\n")
        used = percent(process, 60)
        lines = (robot.folder / "rorg.log").read_bytes().count(b"\n") - lines
        TABLE.add(Row("300 services that crash again and again", used, "%", 5))
        TABLE.add(Row("their lines in the log, a minute", lines, "lines", 300))
        write_tree(robot.tree, {n: {} for n in specs})
        wait_for(lambda: not [s for s in client.services() if s["wanted"]], 120)
        time.sleep(20)
        TABLE.add(Row("memory after them", megabytes(process), "MiB", 60))
