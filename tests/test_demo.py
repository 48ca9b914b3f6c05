"""`rorg demo` shows what it says, and leaves nothing behind, also when it is interrupted."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import alone_on_the_machine, wait_for
from left_behind import left_behind


@pytest.fixture(autouse=True)
def ports() -> Iterator[None]:
    """Its services answer at ports of the machine: another one's that are paused would be taken for ours."""
    with alone_on_the_machine("demo"):
        yield


def demo(folder: Path, *args: str, **env: str) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "rorg", "demo", "--speed", "10", *args],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env={**os.environ, "TMPDIR": str(folder), **env},
    )


def check(output: str) -> None:
    lines = output.splitlines()
    assert any(
        line.split() == ["needed", "by", "navigation"]
        for line in [line.partition("> cartographer_localization")[2] for line in lines]
    )
    assert any("# cartographer_localization" in line for line in lines)
    assert any(line.startswith("cartographer_localization: exited. Nobody ever requested it") for line in lines)
    assert "services/ros_trigger_ui.yaml:8:3: unknown key 'imagge'; try 'image'" in output
    assert "all untouched" in output
    assert "replaced ros_trigger_ui, and nothing else" in output
    assert "back to what was declared before, replaced: ros_trigger_ui" in output
    assert "everything on" in output
    assert "on demand" in output


def test_demo_on_processes(tmp_path):
    process = demo(tmp_path, "--engine", "process")
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 0, output
    check(output)
    assert left_behind(tmp_path, "rorg-demo-") == []


@pytest.mark.docker
def test_demo_on_docker(tmp_path, dockerd):
    process = demo(tmp_path, DOCKER_HOST=dockerd.host)
    output, _ = process.communicate(timeout=150)
    assert process.returncode == 0, output
    assert "on the docker engine" in output.splitlines()[0]
    check(output)
    import docker

    api = docker.APIClient(dockerd.host, version="auto")
    assert [c for c in api.containers(all=True) if "rorg-demo" in c["Names"][0]] == []
    assert left_behind(tmp_path, "rorg-demo-") == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_demo_interrupted(tmp_path, number):
    process = demo(tmp_path, "--engine", "process")
    wait_for(lambda: len(left_behind(tmp_path, "rorg-demo-")) > 8, 60, "a dozen of services")
    process.send_signal(number)
    output, _ = process.communicate(timeout=60)
    assert process.returncode == 130, output
    assert left_behind(tmp_path, "rorg-demo-") == []


def test_demo_without_git(tmp_path):
    process = demo(tmp_path, "--engine", "process", PATH="/nowhere")
    output, _ = process.communicate(timeout=60)
    assert process.returncode == 2, output
    assert (
        output.splitlines()[-1]
        == "rorg: cannot run the demo: git is not installed here; install git, or add it to PATH"
    )
    assert left_behind(tmp_path, "rorg-demo-") == []
