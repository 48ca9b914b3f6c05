"""One state directory is one robot on one engine: nobody orphans it, doubles it, or takes it for another one."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import commands
import pytest
from common import wait_for
from robots import Daemon, RealRobot, write_tree
from rorg_process import RorgProcess

from rorg.store.state_dir import StateDir


def rorg(robot: RealRobot, *words: str, code: int = 0, **environment: str) -> subprocess.CompletedProcess[str]:
    said = {"RORG_STATE_DIR": str(robot.state.path), **environment}
    return commands.rorg(*words, code=code, cwd=robot.state.path.parent, **said)


@pytest.fixture
def wheels(dockerd, tmp_path):
    """A robot whose rorg has stopped, and whose wheels turn on Docker."""
    robot = RealRobot(tmp_path, "docker", dockerd.host)
    robot.declare({"wheels": {"always_on": True, "driver": {}}})
    robot.wait(lambda: robot.active() == {"wheels"} and robot.quiet())
    robot.stop()
    yield robot
    robot.close()


def test_another_engine_does_not_orphan_what_runs(wheels):
    run = wheels.container("wheels").incarnation
    for words in (("run", str(wheels.tree)), ("down", "--yes"), ("apply", str(wheels.tree), "--yes"), ("get",)):
        said = rorg(wheels, *words, code=5, RORG_ENGINE="process").stderr
        assert "docker" in said, words
        assert "rorg down --engine docker" in said, words
    assert wheels.container("wheels").incarnation == run
    assert "wheels" in rorg(wheels, "down", "--yes").stderr, "its engine is known without a word"
    assert not wheels.containers()


def test_nor_does_another_engine_of_the_same_kind(wheels, tmp_path):
    elsewhere = f"unix://{tmp_path}/elsewhere.sock"
    said = rorg(wheels, "down", "--yes", code=5, DOCKER_HOST=elsewhere).stderr
    assert wheels.host in said
    assert elsewhere in said
    assert wheels.active() == {"wheels"}
    (tmp_path / "same").symlink_to(Path(wheels.host.removeprefix("unix://")).parent)
    same = f"unix://{tmp_path}/same/docker.sock"
    rorg(wheels, "down", "--yes", DOCKER_HOST=same)
    assert not wheels.containers()


def test_a_robot_of_an_rorg_of_before_is_known_by_what_that_published(wheels):
    (wheels.state.path / "engine").unlink()
    assert "docker" in rorg(wheels, "down", "--yes", code=5, RORG_ENGINE="process").stderr
    assert wheels.active() == {"wheels"}


def test_an_engine_that_made_nothing_binds_nobody(dockerd, tmp_path):
    """Tried once where there is no Docker, or looked at: another engine may be had."""
    robot = RorgProcess(tmp_path, {"lamp": {"always_on": True}})
    away = {"DOCKER_HOST": f"unix://{tmp_path}/away.sock", "RORG_STATE_DIR": str(robot.state)}
    commands.rorg("diff", str(robot.tree), code=3, RORG_ENGINE="docker", **away)
    try:
        robot.start()
        wait_for(lambda: any(s["pid"] for s in robot.client(patience=60).services()))
    finally:
        robot.close()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["process", pytest.param("docker", marks=pytest.mark.docker)])
def test_a_copied_state_directory_is_not_a_second_robot(request, kind, tmp_path):
    """Two would fight over the same containers."""
    host = request.getfixturevalue("dockerd").host if kind == "docker" else None
    robot = RealRobot(tmp_path, kind, host)
    daemon, copy = Daemon(robot), tmp_path / "copy"
    write_tree(robot.tree, {"wheels": {"always_on": True}})
    daemon.start()
    try:
        robot.wait(lambda: robot.active() == {"wheels"} and daemon.settled())
        shutil.copytree(robot.state.path, copy, ignore=lambda folder, names: {"run", "wakeup"} & set(names))
        run = robot.container("wheels").incarnation
        for words in (("run", str(robot.tree)), ("down", "--yes"), ("apply", str(robot.tree), "--yes")):
            said = rorg(robot, *words, code=5, RORG_STATE_DIR=str(copy), RORG_ENGINE=kind).stderr
            assert str(robot.state.path) in said, words
            assert str(daemon.process.pid) in said, words
        assert robot.container("wheels").incarnation == run
        daemon.kill()
        other = StateDir(copy)
        other.acquire("rorg run")
        assert str(copy) in rorg(robot, "run", str(robot.tree), code=5).stderr, "nor the other way round"
        other.release()
        daemon.start()
        robot.wait(daemon.settled)
        assert robot.container("wheels").incarnation == run, "a lock of the dead is in nobody's way"
    finally:
        daemon.end()
        robot.close()


@pytest.mark.slow
def test_in_the_directory_of_another_robot_that_one_is_run(tmp_path):
    """Not the one that ran last; that is taken where there are no manifests."""
    first = RorgProcess(tmp_path, {"first": {"always_on": True}})
    second = write_tree(tmp_path / "second", {"second": {"always_on": True}})
    (tmp_path / "home").mkdir()
    (tmp_path / "home/compose.yaml").write_text("services: {}\n")
    words = ["run", "--state-dir", str(first.state), "--engine", "process"]
    try:
        first.start()
        for place in (second, tmp_path / "home"):
            wait_for(lambda: any(s["pid"] for s in first.client(patience=60).services()))
            first.stop()
            with (tmp_path / "rorg.log").open("ab") as log:
                first.process = commands.Forked(words, cwd=place, stdout=log, stderr=log)
            wait_for(lambda: first.client(patience=60).status()["tree"]["root"] == str(second))
    finally:
        first.close()


def test_a_container_of_another_rorg_is_said_to_be_its(wheels, dockerd, tmp_path):
    """Though that rorg does not run."""
    other = RealRobot(tmp_path / "other", "docker", dockerd.host)
    try:
        other.declare({"wheels": {"always_on": True}})
        other.wait(lambda: str(wheels.state.path) in other.waits("wheels"))
        assert f"rorg down --state-dir {wheels.state.path}" in other.waits("wheels")
        assert "not rorg's" not in other.waits("wheels")
    finally:
        other.close()
