"""An rorg that is killed in the middle of the change of a manifest: the next one finishes it, or undoes it, and says
which. Nothing is left half."""

from __future__ import annotations

import getpass
import json
import os
import subprocess
from dataclasses import asdict
from pathlib import Path

import commands
import pytest
from common import SUPPORT, wait_for
from rorg_process import RorgProcess

from rorg.api.manifest_change import ManifestChange, recover
from rorg.client import Error, Unreachable
from rorg.host.git import configured_identity
from rorg.store.files import clear_leftovers

KILLED = str(SUPPORT / "programs/killed_at.py")
NEVER = 99
"""More steps than a change has."""
NUMBERS = '{"file": 1, "before": 2, "after": 3, "message": 4, "author": 5}'
FINISHED, UNDONE, NOT_BEGUN = "finished", "undone: nothing had been written", ""


def author() -> str:
    """Whoever runs the tests, as git knows them."""
    return configured_identity(str(Path.home())).get("GIT_AUTHOR_NAME", getpass.getuser())


class Robot(RorgProcess):
    """With a tree in git."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, {"camera": {}, "lidar": {}})
        for args in (["init", "-q"], ["add", "-A"], ["commit", "-qm", "all"]):
            self.git(*args)

    def git(self, *args: str) -> str:
        command = ["git", "-C", str(self.tree), "-c", "user.name=x", "-c", "user.email=x@x", *args]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    def start(self, killed_at: int = NEVER) -> Robot:
        words = [str(killed_at), "run", self.tree, "--state-dir", self.state, "--engine", "process"]
        with (self.folder / "rorg.log").open("ab") as log:
            self.process = commands.Forked(words, stderr=log, stdout=log, program=KILLED)
        return self

    def halves(self) -> list[str]:
        """What should not be left: files on their way to their places, the note of a change, locks, changes that are
        not committed."""
        names = [p.name for p in (*self.tree.glob("*/.*"), *self.state.glob("*manifest-change*"))]
        locks = [p.name for p in (self.tree / ".git").glob("*.lock")]
        return names + locks + self.git("status", "--porcelain").splitlines()

    def outcome(self, message: str) -> str:
        """What the rorg that runs has said of the change with this message."""
        wait_for(lambda: self.client(patience=60).services(), 60)
        wait_for(lambda: not self.halves(), 60, "nothing is left half")
        said = [e["message"] for e in self.client().events(cursor=0) if e["kind"] == "manifest"]
        said = [line for line in said if line.startswith(f"{message} ")]
        assert len(said) < 2
        return said[0].partition(" was interrupted: ")[2] if said else NOT_BEGUN


@pytest.fixture
def robot(tmp_path):
    found = Robot(tmp_path)
    yield found
    found.close()


def base(client, name: str) -> str:
    return next(m["digest"] for m in client.manifests() if m["name"] == name)


def put(robot: Robot, message: str) -> None:
    """Another priority for lidar."""
    digest, text = (
        base(robot.client(), "lidar"),
        robot.client().manifest("Service", "lidar").partition("  priority:")[0],
    )
    priority = int(message.rpartition(" ")[2])
    robot.client(patience=0).put_manifest("Service", "lidar", f"{text}  priority: {priority}\n", digest, message)


def delete(robot: Robot, message: str) -> None:
    robot.client(patience=0).delete_manifest("Service", "camera", base(robot.client(), "camera"), message)


def is_put(robot: Robot, step: int) -> bool:
    return f"priority: {step}\n" in (robot.tree / "services/lidar.yaml").read_text()


def is_deleted(robot: Robot, _: int) -> bool:
    return not (robot.tree / "services/camera.yaml").exists()


# Of a put the note is opened and renamed, the manifest is opened and renamed, git adds and commits, the note is
# removed. Where a manifest is deleted its own two steps are one.
CHAIN = [
    *((put, is_put, step, outcome) for step, outcome in enumerate([NOT_BEGUN, UNDONE, UNDONE, *[FINISHED] * 3], 1)),
    (delete, is_deleted, 2, UNDONE),
    (delete, is_deleted, 3, FINISHED),
]
"""A change, the step before which rorg is killed, and what the next one says of it."""


@pytest.mark.slow
def test_the_next_rorg_finishes_or_undoes_a_change_and_says_so(robot):
    steps = [step for _, _, step, _ in CHAIN]
    robot.start(killed_at=steps[0])
    wait_for(lambda: robot.client(patience=60).services(), 60)
    for (change, done, step, outcome), after in zip(CHAIN, [*steps[1:], NEVER], strict=True):
        with pytest.raises(Error):
            change(robot, f"{change.__name__} {step}")
        assert robot.process.wait(60) == -9
        robot.start(killed_at=after)
        assert robot.outcome(f"{change.__name__} {step}") == outcome
        assert done(robot, step) == (outcome == FINISHED)
        if outcome == FINISHED:
            assert robot.git("log", "-1", "--format=%s by %an") == f"{change.__name__} {step} by {author()}"
    put(robot, "step 9")
    assert robot.git("log", "-1", "--format=%s by %an") == f"step 9 by {author()}"
    assert not robot.halves()


def hook(robot: Robot, text: str) -> None:
    path = robot.tree / ".git/hooks/pre-commit"
    path.write_text(f"#!/bin/sh\nrm $0\n{text}\n")
    path.chmod(0o755)


@pytest.fixture
def git_elsewhere(tmp_path):
    """A git that goes on in another repository, as that of a server."""
    subprocess.run(["git", "init", "--quiet", tmp_path / "other"], check=True)
    with subprocess.Popen(["git", "-C", tmp_path / "other", "cat-file", "--batch"], stdin=subprocess.PIPE) as git:
        yield
        git.stdin.close()


@pytest.mark.slow
@pytest.mark.usefixtures("git_elsewhere")
@pytest.mark.parametrize("also", ["", "kill -9 $PPID\n"], ids=["git goes on", "git is killed too"])
def test_a_kill_while_git_commits_leaves_no_lock_and_nothing_uncommitted(robot, also):
    robot.start()
    wait_for(lambda: robot.client(patience=60).services(), 60)
    hook(robot, f"kill -9 {robot.process.pid}\n{also}")
    with pytest.raises(Unreachable):
        put(robot, "step 7")
    assert robot.process.wait(60) == -9
    robot.start()
    assert robot.outcome("step 7") == FINISHED
    assert is_put(robot, 7)
    assert robot.git("log", "-1", "--format=%s") == "step 7"
    put(robot, "step 8")
    assert robot.git("log", "-1", "--format=%s") == "step 8"


def test_what_somebody_has_changed_since_is_left_to_them(tmp_path):
    note, file = tmp_path / "note", tmp_path / "lidar.yaml"
    file.write_text("mine")
    for before, after in (("1", "2"), (None, "2"), ("1", None)):
        note.write_text(json.dumps(asdict(ManifestChange("lidar.yaml", before, after, "x", "root"))))
        found = recover(tmp_path, note)
        assert found
        assert found[1] == "left as it is: someone has changed it since"
        assert file.read_text() == "mine"
        assert not note.exists()


@pytest.mark.parametrize("text", ["", "{", "[]", '{"file": 1}', '{"file": "a", "more": 1}', NUMBERS])
def test_a_note_that_nobody_can_read_is_taken_away(tmp_path, text):
    (tmp_path / "note").write_text(text)
    assert recover(tmp_path, tmp_path / "note") is None
    assert list(tmp_path.iterdir()) == []


def test_files_on_their_way_of_one_who_lives_are_left_alone(tmp_path):
    ours, dead = f".a.yaml.{os.getpid()}.01234567", ".a.yaml.4194305.01234567"
    names = [ours, dead, f".a.yaml.{os.getppid()}.01234567", ".a.yaml.swp", ".a.yaml.12.0123456", "a.yaml.12.01234567"]
    for name in names:
        (tmp_path / name).touch()
    clear_leftovers(tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == set(names) - {ours, dead}
