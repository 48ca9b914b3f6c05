"""What people type out of habit from kubectl, Docker and Compose, on a robot that runs."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import tarfile
from datetime import UTC, datetime

import commands
import pytest
from common import wait_for
from robots import RealRobot

TREE = {
    "base": {"always_on": True, "command": ["sh", "-c", "echo wheels; exec sleep 1000"]},
    "arm": {"command": ["sh", "-c", "echo grip; exec sleep 1000"]},
}


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    found = RealRobot(tmp_path_factory.mktemp("robot"), "process", None, with_server=True)
    found.declare(TREE)
    found.wait(lambda: "base" in found.active())
    found.settle()
    yield found
    found.close()


@pytest.fixture
def rorg(robot):
    def call(*words: str, code: int = 0, **more) -> subprocess.CompletedProcess:
        return commands.rorg(*words, code=code, RORG_STATE_DIR=str(robot.state.path), RORG_ENGINE="process", **more)

    return call


def test_a_name_may_have_its_kind_in_front(rorg):
    assert rorg("get", "service/base", "-o", "name").stdout == "base\n"
    assert rorg("get", "services/base", "-o", "name").stdout == "base\n"
    assert json.loads(rorg("describe", "service/base", "-o", "json").stdout)["name"] == "base"
    assert "wheels" in rorg("logs", "service/base").stdout
    assert json.loads(rorg("describe", "svc/base", "-o", "json").stdout)["name"] == "base"
    assert "no such service" in rorg("get", "service/bas", code=2).stderr


def test_a_table_without_heads(rorg):
    assert [line.split()[0] for line in rorg("get", "--no-headers").stdout.splitlines()] == ["arm", "base"]
    assert rorg("get", "requests", "--no-headers").stdout == ""


def test_namespaces_are_not_there_and_harm_nothing(rorg):
    done = rorg("get", "-A")
    assert "base" in done.stdout
    assert done.stderr.startswith("-A changes nothing: rorg has no namespaces\n")


def test_stats_and_pull_are_known(rorg):
    assert "CPU" in rorg("stats", "--once").stdout
    assert "Build the images of the tree" in rorg("pull", "--help").stdout


@pytest.fixture
def arm(rorg):
    """It runs during the test."""
    rorg("request", "arm", "--wait")
    yield
    rorg("release", "arm")


def test_logs_of_everything_that_runs(rorg):
    assert rorg("logs").stdout == "wheels\n"


def test_logs_of_all_that_run(rorg, arm):
    wait_for(lambda: "arm  | grip" in rorg("logs").stdout, what="both are read")
    assert "base | wheels" in rorg("logs").stdout


def test_times_are_not_kept_by_the_process_engine(rorg):
    for option in ("--previous", "--until=1s"):
        assert "keeps no times of lines" in rorg("logs", "base", option, code=2).stderr
    assert "earlier lines are asked for" in rorg("logs", "base", "--previous", "-f", code=2).stderr


def test_events_of_one_service(rorg, arm):
    told = [json.loads(line) for line in rorg("events", "arm", "-o", "json").stdout.splitlines()]
    assert told
    assert {"arm"} == {
        name for event in told for name in [event.get("service"), *(event.get("services") or [])] if name
    }


def test_copies_as_a_tar_stream(robot, tmp_path):
    def cp(*words: str, given: bytes = b"") -> subprocess.CompletedProcess[bytes]:
        environment = {**os.environ, "RORG_STATE_DIR": str(robot.state.path), "RORG_ENGINE": "process"}
        return subprocess.run(
            [sys.executable, "-m", "rorg", "cp", *words], input=given, capture_output=True, env=environment, timeout=60
        )

    (tmp_path / "map").mkdir()
    (tmp_path / "map/a.yaml").write_text("one")
    packed = cp(f"base:{tmp_path}/map", "-").stdout
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        assert archive.extractfile("map/a.yaml").read() == b"one"
    (tmp_path / "other").mkdir()
    assert cp("-", f"base:{tmp_path}/other", given=packed).returncode == 0
    assert (tmp_path / "other/map/a.yaml").read_text() == "one"
    refused = cp("-", f"base:{tmp_path}/other", given=b"no archive")
    assert (refused.returncode, b"is no tar stream" in refused.stderr) == (2, True)


@pytest.mark.slow
def test_apply_says_that_it_does_not_wait_for_the_bake_or_does(rorg, robot):
    changed = {"update": {"bake": "3s"}, "container": {"environment": {"A": "1"}}}
    robot.declare({**TREE, "base": {**TREE["base"], **changed}})
    assert "`rorg apply --wait=proven` waits for that" in rorg("apply", "--yes", "--wait").stderr
    rorg("apply", "--yes", "--wait=proven", "--timeout", "60s")
    assert "baking" not in rorg("get").stderr
    assert "'x' is not one of 'ready', 'proven'" in rorg("apply", "--wait=x", code=2).stderr


@pytest.mark.docker
def test_what_it_said_before_the_current_run(dockerd, tmp_path):
    robot = RealRobot(tmp_path, "docker", dockerd.host, with_server=True)
    try:
        # A shell speaks within a millisecond, before the engine has noted the start.
        sleeps = "exec python3 -S -c 'import time; time.sleep(1000)'"
        says = f"read id < /proc/sys/kernel/random/uuid; echo run $id; {sleeps}"
        robot.declare({"base": {"always_on": True, "command": ["sh", "-c", says]}})
        robot.wait(lambda: robot.active() == {"base"})

        def logs(*words: str) -> list[str]:
            state = {"RORG_STATE_DIR": str(robot.state.path), "DOCKER_HOST": dockerd.host}
            return commands.rorg("logs", "base", *words, **state).stdout.splitlines()

        wait_for(lambda: len(logs()) == 1, what="the first run has said it")
        first, at = logs()[0], datetime.now(UTC).isoformat()
        assert logs("--previous") == []
        robot.kill("base")
        wait_for(lambda: len(logs()) == 2, what="the second run has said it")
        assert logs("--previous") == logs("--until", at) == logs("-p", "-n", "1") == [first]
    finally:
        robot.close()
