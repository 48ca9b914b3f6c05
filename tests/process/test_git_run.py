"""`rorg run` that follows a repository: what is pushed comes into force, and nothing else does."""

from __future__ import annotations

import os
import re
import signal

import commands
import pytest
from common import wait_for
from git_origin import Origin, git
from robots import write_tree
from rorg_client import Refused
from rorg_process import RorgProcess

SERVICES = {"camera": {"always_on": True}, "arm": {}}
BROKEN = "apiVersion: rorg/v1\nkind: Service\nmetadata: {name: arm}\nspec: {imgae: x}\n"


@pytest.fixture
def robot(tmp_path):
    """Nothing polls: an hour is longer than a test."""
    origin = Origin(tmp_path / "origin")
    write_tree(origin.clone / "robot", SERVICES)
    found = RorgProcess(tmp_path, {}, "--poll", "1h")
    found.origin = origin
    found.manifests = ["--git", f"{origin.bare}@main", "--path", "robot"]
    yield found
    found.close()


def pushed(robot: RorgProcess, services: dict, message: str = "Change") -> str:
    write_tree(robot.origin.clone / "robot", services)
    return robot.origin.push(message)


def rorg(robot: RorgProcess, *words: str, code: int = 0) -> str:
    done = commands.rorg(*words, code=code, cwd=robot.folder, RORG_STATE_DIR=str(robot.state), RORG_ENGINE="process")
    return done.stdout + done.stderr


def in_force(robot: RorgProcess) -> dict:
    return robot.client(patience=60).call("GET", "/v1/status")["tree"]["git"]


def names(robot: RorgProcess) -> set[str]:
    return {s["service"] for s in robot.client(patience=60).services()}


def told(robot: RorgProcess, kind: str) -> list[str]:
    return [event["message"] for event in robot.client().events(0) if event["kind"] == kind]


@pytest.mark.slow
def test_what_is_pushed_comes_into_force_and_what_is_wrong_does_not(robot):
    first = robot.origin.push("A robot")
    robot.start()
    wait_for(lambda: robot.client(patience=60).service("camera")["state"] == "running")
    assert in_force(robot)["commit"] == first
    run = robot.client().service("camera")["incarnation"]

    second = pushed(robot, {**SERVICES, "leg": {}}, "A leg")
    wait_for(lambda: "leg" in names(robot), what="a push to be noticed")
    assert in_force(robot)["commit"] == second
    wait_for(lambda: any("A leg (Anna) comes into force" in text for text in told(robot, "git-commit")))

    robot.origin.push("Wrong", {"robot/services/arm.yaml": BROKEN})
    wait_for(lambda: robot.client().call("GET", "/v1/status")["tree"]["errors"])
    assert "arm" in names(robot)
    wait_for(lambda: any("Wrong (Anna) is refused" in text for text in told(robot, "git-commit")))
    assert not any("Wrong" in text and "force" in text for text in told(robot, "git-commit"))

    git(robot.origin.clone, "reset", "--quiet", "--hard", first)
    pushed(robot, {"camera": {}}, "Another history")
    wait_for(lambda: "does not follow" in in_force(robot)["error"])
    assert names(robot) >= {"camera", "arm", "leg"}
    assert "does not follow" in rorg(robot, "get")
    assert len(told(robot, "git-refused")) == 1
    assert robot.client().service("camera")["incarnation"] == run


@pytest.mark.slow
def test_a_commit_that_declares_the_same_is_in_force_too(robot):
    robot.origin.push("A robot")
    robot.start()
    wait_for(lambda: robot.client(patience=60).service("camera")["state"] == "running")
    made = robot.origin.push("Words", {"README.md": "A robot\n"})
    wait_for(lambda: robot.client().call("GET", "/v1/status")["tree"]["revision"] == made[:7])


@pytest.mark.slow
def test_without_its_repository_it_runs_what_it_has(robot):
    made = robot.origin.push("A robot")
    robot.start()
    wait_for(lambda: robot.client(patience=60).service("camera")["state"] == "running")
    robot.stop(kill=True)
    robot.origin.bare.rename(robot.folder / "away")
    robot.start()
    wait_for(lambda: in_force(robot)["error"])
    found = in_force(robot)
    assert found["commit"] == made
    assert robot.client().service("camera")["state"] == "running"
    assert "origin.git" in rorg(robot, "get", "camera")
    wait_for(lambda: told(robot, "git-unreachable"))

    (robot.folder / "away").rename(robot.origin.bare)
    second = pushed(robot, {**SERVICES, "leg": {}})
    wait_for(lambda: in_force(robot)["commit"] == second, what="it to be followed again")
    wait_for(lambda: told(robot, "git"))


@pytest.mark.slow
def test_where_nothing_is_here_yet_it_says_so_and_waits(robot):
    robot.start()
    wait_for(lambda: in_force(robot)["error"])
    found = robot.client().call("GET", "/v1/status")
    assert "nothing was fetched yet" in found["tree"]["errors"][0]["message"]
    robot.origin.push("A robot")
    os.kill(robot.process.pid, signal.SIGHUP)
    wait_for(lambda: "camera" in names(robot))
    assert not robot.client().call("GET", "/v1/status")["tree"]["errors"]


@pytest.mark.slow
def test_apply_looks_at_once_and_edits_are_refused(robot):
    robot.origin.push("A robot")
    far = f"file://{robot.folder}/far.git"  # what is not there is not watched
    robot.manifests = ["--git", f"{far}@main", "--path", "robot"]
    robot.start()
    wait_for(lambda: in_force(robot)["error"])
    robot.origin.bare.rename(robot.folder / "far.git")
    shown = rorg(robot, "apply", "--yes", "--wait")
    assert f"far.git: is at {git(robot.origin.clone, 'rev-parse', 'HEAD')[:10]}" in shown
    assert robot.client().service("camera")["state"] == "running"
    text = robot.client().manifest("Service", "arm")
    base = next(m["digest"] for m in robot.client().manifests() if m["name"] == "arm")
    with pytest.raises(Refused, match=r"manifests are those of .*far.git@main, robot; commit there"):
        robot.client().put_manifest("Service", "arm", text + "  priority: 3\n", base)
    robot.stop()
    assert "they are those of a repository" in rorg(robot, "edit", "arm", code=5)


@pytest.mark.slow
def test_only_what_is_committed_counts(tmp_path):
    robot = RorgProcess(tmp_path, {"camera": {}}, "--committed", "--poll", "1h")
    try:
        git(tmp_path, "init", "--quiet")
        (tmp_path / ".gitignore").write_text("state\nrorg.log\n")
        git(tmp_path, "add", "--all")
        git(tmp_path, "commit", "--quiet", "--message", "One")
        write_tree(robot.tree, {"camera": {}, "arm": {}})
        robot.start()
        wait_for(lambda: names(robot) == {"camera", "developer"})
        git(tmp_path, "add", "--all")
        git(tmp_path, "commit", "--quiet", "--amend", "--message", "Another one")
        wait_for(lambda: "arm" in names(robot))
    finally:
        robot.close()


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--git", "x@a..b"], "is not a valid branch name"),
        (["--git", "x", "--path", "../y"], "not inside the repository"),
        (["--git", "x", "--committed"], "they are mutually exclusive"),
        (["tree", "--git", "https://anna:pass@example.org/x"], r"https://\*\*\*@example.org/x and DIRECTORY"),
        (["--path", "x"], "no repository is followed"),
        (["tree", "--committed"], "not in a git repository"),
        (["--git", "x", "--signers", "nowhere"], "no such file"),
        (["--git", "x", "--poll", "0.5s"], "the minimum is 1"),
    ],
)
def test_what_cannot_be_followed(tmp_path, words, why):
    (tmp_path / "tree").mkdir()
    done = commands.run(["run", *words], {**os.environ, "RORG_STATE_DIR": str(tmp_path / "state")}, tmp_path)
    assert done.returncode == 2
    assert re.search(why, done.stderr), done.stderr
    assert not (tmp_path / "state").exists()
