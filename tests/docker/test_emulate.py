"""`rorg emulate` plays a trace with everything on and with rorg, measures both, and leaves nothing behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from common import free_port, wait_for
from left_behind import left_behind
from robots import write_tree

from rorg.daemon.tree import Tree
from rorg.errors import Exit
from rorg.tools.sim.throwaway import ThrowawayRobot

PREFIX = "rorg-emulate-"
TRACE = {
    "duration": "24s",
    "behaviour": "behaviour",
    "states": {"look": ["eyes"], "drive": ["wheels"], "rest": []},
    "events": [
        {"at": "0s", "request": "autonomy", "services": ["behaviour"]},
        {"at": "2s", "state": "look"},
        {"at": "8s", "state": "drive"},
        {"at": "16s", "state": "rest"},
    ],
}


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """A trace, and the robot that it is for: half of what could run is never asked for."""
    small, stop = {"cpu": 0.02, "memory": "30Mi"}, {"action": "stop", "linger": "0s"}
    services = {
        "base": {"always_on": True, "resources": small, "ready": {"tcp": free_port()}},
        "behaviour": {"needs": ["base"], "resources": small, "idle": stop},
        "eyes": {"needs": ["base"], "resources": small, "idle": {"action": "pause", "linger": "500ms"}},
        "wheels": {"needs": ["base"], "resources": small, "idle": stop},
        "arm": {"resources": {"cpu": 0.2, "memory": "90Mi"}, "idle": stop},
    }
    trace = tmp_path / "trace.yaml"
    trace.write_text(
        yaml.safe_dump({"apiVersion": "rorg/v1", "kind": "Trace", "metadata": {"name": "t"}, "spec": TRACE})
    )
    return trace, write_tree(tmp_path / "tree", services)


def emulate(tmp_path: Path, *args: object, **env: str) -> subprocess.Popen:
    folder = tmp_path / "temporary"
    folder.mkdir()
    return subprocess.Popen(
        [sys.executable, "-m", "rorg", "emulate", *map(str, args)],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(folder), **env},
    )


def check(result: dict) -> None:
    """Of two valid runs."""
    assert result["trace"] == "t"
    all_on, rorg = result["runs"]
    assert (all_on["name"], rorg["name"]) == ("all-on", "rorg")
    assert all_on["samples"]["changes"] == [
        {"at": all_on["samples"]["at"][0], "active": ["arm", "base", "behaviour", "eyes", "wheels"], "not_active": []}
    ]
    assert {n for change in rorg["samples"]["changes"] for n in change["active"]} == {
        *("base", "behaviour", "eyes", "wheels")
    }
    assert rorg["actions"]["start"] == 3
    assert rorg["actions"]["pause"] == 1
    assert result["reductions"]["cpu"]["mean"] > 0.1
    assert result["reductions"]["memory"]["mean"] > 0.2
    assert result["reductions"]["memory"]["deviation"] is None, "of one pair"
    assert all_on["scaled_back"]["memory"] == pytest.approx(all_on["memory"], rel=0.01)
    assert 300 << 20 > all_on["memory"] > 100 << 20
    for run in (all_on, rorg):
        assert len(run["samples"]["at"]) == len(run["samples"]["cpu"]) == 6
        assert run["rorg"]["cpu"] > 0
        assert run["simulated"]["memory"] == pytest.approx(run["memory"], rel=0.4)
        assert {s: r["requests"] for s, r in run["responses"].items()} == {"autonomy": 1, "look": 1, "drive": 1}
        assert run["responses"]["drive"]["ready"] == 1
        assert run["agreement"]["replayed"]["services"] > 0.7
        assert not run["violations"]
        assert run["invalid"] == []
        assert run["stand_ins"]["base"]["got"] > 0


def check_refused(result: dict, output: str, told: str) -> None:
    """Other tests, or other programs of this machine, ran at the same time."""
    flaws = result["runs"][-1]["invalid"]
    assert flaws
    assert output == ""
    assert result["reductions"] == {}
    assert all(flaw["why"] in told.splitlines()[-1] for flaw in flaws)


def play(tmp_path: Path, trace: Path, tree: Path, **env: str) -> None:
    saved = tmp_path / "saved.json"
    picture = tmp_path / "picture.svg"
    args = ("--compress", 4, "--pairs", 1, "--scale", 1, "--save", saved, "--plot", picture, "-o", "json")
    process = emulate(tmp_path, trace, tree, *args, **env)
    output, told = process.communicate(timeout=120)
    assert left_behind(tmp_path / "temporary", PREFIX) == []
    assert process.returncode in (Exit.OK, Exit.REFUSED), told
    result = json.loads(saved.read_text())
    if process.returncode == Exit.REFUSED:
        check_refused(result, output, told)
        return
    check(result)
    assert json.loads(output) == result
    assert "measured on the" in picture.read_text()
    assert "pair 1 of 1, rorg" in told


@pytest.mark.slow
def test_emulation_on_processes(tmp_path, files):
    play(tmp_path, *files, RORG_ENGINE="process")


@pytest.fixture
def busy_loops() -> Iterator[None]:
    """Two programs that never rest; more on a machine with many cores."""
    loop = [sys.executable, "-c", "while True: pass"]
    loops = [subprocess.Popen(loop) for _ in range(max(2, (os.cpu_count() or 1) // 4))]
    yield
    for one in loops:
        one.kill()
        one.wait()


@pytest.mark.slow
@pytest.mark.usefixtures("busy_loops")
@pytest.mark.parametrize("form", ["table", "json"])
def test_beside_two_busy_loops_it_ends_with_an_error_and_no_figure(tmp_path, files, form):
    saved, picture = tmp_path / "saved.json", tmp_path / "picture.svg"
    args = ("--engine", "process", "--compress", 8, "--pairs", 1, "--scale", 1)
    process = emulate(tmp_path, *files, *args, "--save", saved, "--plot", picture, "-o", form)
    output, told = process.communicate(timeout=120)
    assert (process.returncode, output) == (Exit.REFUSED, ""), told
    *before, error = told.splitlines()
    assert error.startswith("rorg: cannot report the run all-on of pair 1: other programs used ")
    assert error.endswith("; end them, or measure on a machine that does nothing else")
    assert not any("cores" in line for line in before)
    assert not picture.exists()
    check_refused(json.loads(saved.read_text()), output, told)
    assert left_behind(tmp_path / "temporary", PREFIX) == []


@pytest.mark.slow
def test_a_stand_in_that_does_not_get_its_cpu_makes_the_run_invalid(tmp_path, files):
    """It wants more than the machine has."""
    trace, tree = files
    arm, saved = tree / "services/arm.yaml", tmp_path / "saved.json"
    manifest = yaml.safe_load(arm.read_text())
    manifest["spec"]["resources"]["cpu"] = 1.5 * (os.cpu_count() or 1)
    arm.write_text(yaml.safe_dump(manifest))
    args = ("--engine", "process", "--compress", 8, "--pairs", 1, "--scale", 1, "--save", saved)
    process = emulate(tmp_path, trace, tree, *args)
    output, told = process.communicate(timeout=120)
    assert process.returncode == Exit.REFUSED, told
    result = json.loads(saved.read_text())
    check_refused(result, output, told)
    assert "starved" in {flaw["code"] for flaw in result["runs"][0]["invalid"]}
    arm_got = result["runs"][0]["stand_ins"]["arm"]
    assert 0 < arm_got["got"] < 0.95 * arm_got["wanted"]


def tags(api) -> set[str]:
    """Of all images; what older tests left without one is no name."""
    return {tag for image in api.images() for tag in image["RepoTags"] or ()} - {"<none>:<none>"}


@pytest.mark.docker
def test_emulation_on_docker(tmp_path, files, dockerd):
    import docker

    api = docker.APIClient(dockerd.host, version="auto")
    before = tags(api)
    play(tmp_path, *files, DOCKER_HOST=dockerd.host)
    assert [c for c in api.containers(all=True) if PREFIX in c["Names"][0]] == []
    assert tags(api) == before


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_what_is_interrupted_leaves_nothing_but_what_was_saved(tmp_path, files, number):
    saved = tmp_path / "saved.json"
    saved.write_text("earlier")
    process = emulate(tmp_path, *files, "--engine", "process", "--compress", 1, "--save", saved)
    wait_for(lambda: len(left_behind(tmp_path / "temporary", PREFIX)) > 4, 60, "the first run")
    process.send_signal(number)
    _, told = process.communicate(timeout=60)
    assert process.returncode == 130, told
    assert told.splitlines()[-1] == "interrupted"
    assert saved.read_text() == "earlier"
    assert left_behind(tmp_path / "temporary", PREFIX) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("args", "told"),
    [
        (["--compress", "24"], "it takes 1 s when compressed, less than 2 s; try a smaller --compress"),
        (["--save", "nowhere/x.json"], "cannot write nowhere/x.json: No such file or directory"),
        (["--plot", "x.pdf"], "cannot draw x.pdf: '.pdf' is not a supported format; try .svg, .png or .html"),
        (["--engine", "kubernetes"], "kubernetes"),
        (["-o", "yml"], "'yml' is not one of"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_done(tmp_path, files, args, told):
    process = emulate(tmp_path, *files, *args)
    output, error = process.communicate(timeout=60)
    assert (process.returncode, output) == (2, "")
    assert told in error
    assert list((tmp_path / "temporary").iterdir()) == []


def test_a_trace_for_another_robot_is_refused_with_its_place(tmp_path, files):
    trace, tree = files
    trace.write_text(trace.read_text().replace("- wheels", "- weels"))
    process = emulate(tmp_path, trace, tree)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 2
    line = next(n for n, text in enumerate(trace.read_text().splitlines(), 1) if "weels" in text)
    assert f"{trace}:{line}:" in error
    assert "no service or group 'weels'; try 'wheels'" in error


def test_without_an_engine_nothing_is_left(tmp_path, files):
    process = emulate(tmp_path, *files, DOCKER_HOST=f"unix://{tmp_path}/nothing.sock")
    _, error = process.communicate(timeout=60)
    assert process.returncode == 3, error
    assert left_behind(tmp_path / "temporary", PREFIX) == []


def test_a_container_that_starts_while_all_is_removed_is_removed_too(tmp_path):
    """By an action that was under way: what was listed as created runs by now."""
    robot = ThrowawayRobot("process", PREFIX)
    said: list[str] = []
    root = write_tree(tmp_path / "tree", {"arm": {"always_on": True}})
    tree = Tree(root, str(robot.state.run), references=robot.references)
    try:
        robot.run(tree, said.append, "tests")
        robot.settle("the start")
        (arm,) = robot.engine.list()
        assert robot._remove(replace(arm, state="created")) == ""
        assert not robot.engine.list()
    finally:
        robot.clean_up(said.append)
    assert not [line for line in said if "not everything" in line]
