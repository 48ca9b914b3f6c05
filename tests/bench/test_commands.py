"""Whole commands as a person feels them, each beside a bare python in the same run: `make bench`.

COMPOSE names a binary of Docker Compose to measure beside: the same containers brought up by it.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
from pathlib import Path

import pytest
from command_times import ENVIRONMENT, RORG, measure, timed
from common import BASE_IMAGE, wait_for
from robots import WORK, write_tree
from rorg_process import RorgProcess
from rows import states

from rorg.engines.make import make_engine
from rorg.store.state_dir import StateDir

COMPOSE = os.environ.get("COMPOSE", "")


def specs(count: int) -> dict[str, dict]:
    """A quarter of them run, in short chains. s000 is ceased, s001 has a probe that says when it is ready."""
    found = {
        f"s{n:03}": {"always_on": n % 4 == 1, "needs": [f"s{n - 1:03}"] if n % 8 == 2 else []} for n in range(count)
    }
    found["s001"]["ready"] = {"exec": ["sh", "-c", "exit 0"]}
    return found


def edit(tree: Path, number: int) -> None:
    """Changes one service that runs, so that it needs a new container."""
    path = tree / "services/s001.yaml"
    lines = [line for line in path.read_text().splitlines() if "container:" not in line]
    path.write_text("\n".join([*lines, f'  container: {{environment: {{NUMBER: "{number}"}}}}']) + "\n")


@pytest.mark.parametrize("count", [41, 200])
def test_commands_of_a_running_rorg(tmp_path, count):
    robot = RorgProcess(tmp_path, specs(count)).start()
    env = {**ENVIRONMENT, "RORG_STATE_DIR": str(robot.state), "RORG_ENGINE": "process"}
    try:
        wait_for(lambda: (robot.state / "run/rorg.sock").exists(), 30)
        timed([*RORG, "apply", "--yes", "--wait"], env)
        where = f"{count} services, with a loop"
        for line in ("get", "why s001", "request s000", "release s000", "diff", "apply --yes --wait"):
            measure(f"{where}: {line}", [*RORG, *line.split()], env)
        measure(f"{where}: TAB", [*RORG, "why", "s00"], {**env, "_RORG_COMPLETE": "bash"})
        client = robot.client()

        def release(_: int) -> None:
            client.release("s000", "developer")
            wait_for(lambda: client.service("s000")["state"] != "running")

        wall = measure(f"{where}: request --wait", [*RORG, "request", "s000", "--wait"], env, before=release)
        calls = [e["seconds"] for e in client.events(tail=400) if e.get("verb") == "start" and e["service"] == "s000"]
        print(f", of which the engine's call {statistics.median(calls) * 1000 if calls else 0:.0f} ms", end="")
        assert wall > 0
        measure(
            f"{where}: apply --yes --wait, one changed",
            [*RORG, "apply", "--yes", "--wait"],
            env,
            before=lambda n: edit(robot.tree, n),
        )
    finally:
        robot.close()


def alone(where: str, tree: Path, env: dict[str, str], times: int) -> None:
    apply = [*RORG, "apply", str(tree), "--yes", "--wait"]
    measure(f"{where}: diff", [*RORG, "diff", str(tree)], env, times)
    measure(f"{where}: nothing changed", apply, env, times)
    measure(f"{where}: one changed", apply, env, times, lambda n: edit(tree, n))


@pytest.mark.parametrize("count", [41, 200])
def test_commands_alone(tmp_path, count):
    tree, state = write_tree(tmp_path / "tree", specs(count)), tmp_path / "state"
    env = {**ENVIRONMENT, "RORG_STATE_DIR": str(state), "RORG_ENGINE": "process"}
    try:
        measure(f"{count} services, alone: all from nothing", [*RORG, "apply", str(tree), "--yes", "--wait"], env, 1)
        alone(f"{count} services, alone", tree, env, 7)
    finally:
        clear(state, "process")


def clear(state: Path, kind: str) -> None:
    engine = make_engine(kind, StateDir(state))
    for container in engine.list():
        if container.alive:
            engine.stop(container.id, "SIGKILL", 5.0)
        engine.remove(container.id)


def compose_file(folder: Path, services: dict[str, dict]) -> Path:
    """The same containers for Compose; all of them run."""
    path = folder / "compose.json"
    one = {"image": BASE_IMAGE, "command": WORK, "network_mode": "host", "init": True}
    path.write_text(json.dumps({"name": "bench", "services": dict.fromkeys(services, one)}))
    return path


@pytest.mark.parametrize("count", [41, 200])
def test_apply_on_docker_beside_compose(dockerd, tmp_path, count):
    """All services run, as under Compose."""
    declared = {f"s{n:03}": {"always_on": True} for n in range(count)}
    declared["s001"]["ready"] = {"exec": ["sh", "-c", "exit 0"]}
    tree, state = write_tree(tmp_path / "tree", declared), tmp_path / "state"
    env = {**ENVIRONMENT, "RORG_STATE_DIR": str(state), "RORG_ENGINE": "docker", "DOCKER_HOST": dockerd.host}
    os.environ["DOCKER_HOST"] = dockerd.host  # for clear()
    where = f"{count} services on Docker"
    try:
        ours = [measure(f"{where}: all from nothing", [*RORG, "apply", str(tree), "--yes", "--wait"], env, 1)]
        apply = [*RORG, "apply", str(tree), "--yes", "--wait"]
        ours.append(measure(f"{where}: nothing changed", apply, env, 5))
        ours.append(measure(f"{where}: one changed", apply, env, 5, lambda n: edit(tree, n)))
        with_a_loop(where, tree, state, env)
    finally:
        clear(state, "docker")
    if COMPOSE:
        beside(where, compose_file(tmp_path, declared), env, ours)


def with_a_loop(where: str, tree: Path, state: Path, env: dict[str, str]) -> None:
    with subprocess.Popen(
        [*RORG, "run", str(tree)], env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as run:
        try:
            wait_for(lambda: (state / "run/rorg.sock").exists())
            apply = [*RORG, "apply", "--yes", "--wait"]
            timed(apply, env)
            measure(f"{where}, with a loop: diff", [*RORG, "diff"], env, 9)
            measure(f"{where}, with a loop: nothing changed", apply, env, 9)
            measure(f"{where}, with a loop: one changed", apply, env, 5, lambda n: edit(tree, n + 100))
        finally:
            run.terminate()


def beside(where: str, file: Path, env: dict[str, str], ours: list[float]) -> None:
    up = [COMPOSE, "-f", str(file), "up", "-d", "--quiet-pull"]

    def change(number: int) -> None:
        found = json.loads(file.read_text())
        found["services"]["s001"]["environment"] = {"NUMBER": str(number)}
        file.write_text(json.dumps(found))

    wait_for(lambda: not states(env["DOCKER_HOST"]), 60, "an engine without containers")
    try:
        theirs = [measure(f"{where}, Compose: all from nothing", up, env, 1)]
        theirs.append(measure(f"{where}, Compose: nothing changed", up, env, 5))
        theirs.append(measure(f"{where}, Compose: one changed", up, env, 5, change))
    finally:
        subprocess.run([COMPOSE, "-f", str(file), "kill"], env=env, capture_output=True)
        subprocess.run([COMPOSE, "-f", str(file), "down", "-t", "0"], env=env, capture_output=True)
    for what, us, them in zip(("all from nothing", "nothing changed", "one changed"), ours, theirs, strict=True):
        print(f"\n{where}, {what}: rorg takes {us / them:.2f} times as long as Compose", end="")
