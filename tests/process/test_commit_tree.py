"""States of the tree from its repository's history: read as if they lay in the tree now."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from repositories import Repository
from robots import RealRobot, write_tree
from thin_commands import rorg

from rorg.daemon.commit_tree import load_at
from rorg.errors import Invalid, Unreachable
from rorg.history.revisions import Revisions
from rorg.host import contents

IMAGE = "apiVersion: rorg/v1\nkind: Image\nmetadata: {{name: {name}}}\nspec: {spec}\n"


@pytest.fixture
def repository(tmp_path):
    return Repository(tmp_path / "home" / "robot")


def every_kind_of_file(repository: Repository, mask: int) -> list[str]:
    """A history of commits in which each kind of file that a tree is made of changes."""
    write, commits = repository.write, []

    def commit() -> None:
        commits.append(repository.commit())

    write(".gitignore", "*.secret\nbuilt/\n")
    write(".gitattributes", "config.ini export-ignore\n*.crlf eol=crlf\n")
    write("../beside/Dockerfile", "FROM scratch\nCOPY . .\n")  # in no repository
    write("manifests/services/a/config.ini", "one")
    write("manifests/services/a/deep/er/x.crlf", "1\n2\n")
    write("manifests/services/a/seccomp.json", '{"defaultAction": "SCMP_ACT_ALLOW"}')
    write("manifests/services/a/pass.secret", "TOKEN=unknown to git")
    write("manifests/services/a/maps/big.secret", "a map")
    write("images/a/Dockerfile", "FROM scratch\nCOPY . .\n")
    write("images/a/run.sh", "#!/bin/sh\n", 0o777 & ~mask)
    write("images/a/built/out", "left out by .dockerignore later")
    write("manifests/images/a.yaml", IMAGE.format(name="lab/a:1", spec="{context: ../../images/a}"))
    write("manifests/images/b.yaml", IMAGE.format(name="lab/b:1", spec="{context: ../../../beside}"))
    container = (
        "{volumes: ['./a/deep:/deep:ro', '../../images:/i:ro'], env_file: a/pass.secret, "
        "security_opt: ['seccomp=a/seccomp.json']}"
    )
    repository.service(
        "aa", f"{{image: 'lab/a:1', mounts: ['./a/config.ini:/c', './a/maps:/m'], container: {container}}}"
    )
    commit()
    write("manifests/services/a/config.ini", "two")
    os.symlink("a", repository.tree / "services/link")
    commit()
    write("manifests/services/a/deep/er/x.crlf", "3\n")
    write("images/a/.dockerignore", "built\n")
    write("images/a/new", "new")
    (repository.top / "images/a/run.sh").chmod(0o666 & ~mask)
    commit()
    raw = "{path: a/seccomp.json, format: raw}"
    repository.service("bb", f"{{image: 'lab/b:1', needs: [aa], container: {{env_file: {raw}}}}}")
    write("manifests/services/a/seccomp.json", '{"defaultAction": "SCMP_ACT_LOG"}')
    write("images/a/only\nnow", "a line's end in its name")
    commit()
    (repository.tree / "services/link").unlink()
    write("manifests/services/link", "a file where a link was")
    (repository.tree / "services/a/deep/er/x.crlf").unlink()
    write("manifests/services/a/deep/kept", "")
    commit()
    return commits


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_a_past_state_is_what_a_checkout_of_it_would_be(repository, mask):
    before = os.umask(mask)
    try:
        commits = every_kind_of_file(repository, mask)
        past = {commit: load_at(repository.unread(), commit) for commit in commits}
        for commit in commits:
            repository.git("checkout", "--quiet", commit)
            now = repository.read()
            assert past[commit].images == now.images
            assert past[commit].desired == now.desired
            assert past[commit].commit == commit
            assert load_at(repository.unread(), "HEAD").desired == now.desired
        assert len({p.catalog.fingerprint for p in past.values()}) == len(commits)
        assert len({p.desired.editions["aa"] for p in past.values()}) == len(commits)
    finally:
        os.umask(before)


@pytest.fixture
def theirs():
    """A directory that others may look into."""
    with tempfile.TemporaryDirectory(prefix="rorg-theirs-") as folder:
        os.chmod(folder, 0o755)
        yield Path(folder)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root acts for others")
def test_the_repository_of_another_user_is_read_in_their_name(theirs):
    repository = Repository(theirs / "robot")
    commits = every_kind_of_file(repository, 0o022)
    plain = load_at(repository.unread(), commits[1])
    for path in (repository.top, *repository.top.rglob("*")):
        os.chown(path, 65534, 65534, follow_symlinks=False)
    assert load_at(repository.unread(), commits[1]).desired == plain.desired


def test_what_git_does_not_know_is_brought_up_to_where_nobody_looks_any_more(repository, monkeypatch):
    repository.write(".gitignore", "*.bin\n")
    repository.write("manifests/services/aa/kept", "x")
    repository.service("aa", "{image: x, mounts: ['./aa:/a']}")
    commit = repository.commit()
    monkeypatch.setattr(contents, "MOST_FILES", 3)
    seen = []
    for number in range(5):
        os.mkfifo(repository.tree / f"services/aa/pipe{number}")
        repository.write(f"manifests/services/aa/{number}.bin", "x" * number)
        past, now = load_at(repository.unread(), commit).desired.contents, repository.read().desired.contents
        assert past == now
        seen.append("aa" in now)
    assert seen == [True, True, False, False, False]


def test_a_crafted_commit_writes_nowhere_else(repository, tmp_path):
    """A link out of the tree, and a file below it, as no checkout would have them."""
    (tmp_path / "outside").mkdir()
    repository.service("aa")
    repository.commit()
    blob = repository.git("hash-object", "-w", str(repository.tree / "services/aa.yaml"))
    repository.write("link", str(tmp_path / "outside"))
    link = repository.git("hash-object", "-w", "link")
    inner = tree_object(repository, f"100644 blob {blob}\tfile")
    top = tree_object(repository, f"120000 blob {link}\tlink\n040000 tree {inner}\tlink")
    commit = repository.git("commit-tree", "-m", "crafted", top)
    with pytest.raises(Unreachable, match="below a path that is also a file"):
        load_at(repository.unread(), commit)
    dotted = tree_object(repository, f"040000 tree {inner}\t..")
    with pytest.raises(Unreachable, match=re.escape("has a file '../file'")):
        load_at(repository.unread(), repository.git("commit-tree", "-m", "crafted", dotted))
    assert not list((tmp_path / "outside").iterdir())


def tree_object(repository: Repository, lines: str) -> str:
    """Of git, whatever is in it."""
    content = b""
    for line in lines.splitlines():
        about, _, name = line.partition("\t")
        mode, _, digest = about.split()
        content += f"{mode.lstrip('0')} {name}\0".encode() + bytes.fromhex(digest)
    words = ["git", "hash-object", "-t", "tree", "-w", "--literally", "--stdin"]
    return (
        subprocess.run(words, input=content, cwd=repository.top, capture_output=True, check=True)
        .stdout.decode()
        .strip()
    )


def test_nothing_of_it_is_left_behind(repository, monkeypatch, tmp_path):
    (tmp_path / "temporary").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    monkeypatch.setattr(tempfile, "tempdir", None)
    repository.service("aa")
    repository.commit()
    repository.service("aa", "{imag: x}")
    broken = repository.commit()
    before = repository.git("status", "--porcelain", "--ignored"), sorted(os.listdir(repository.top / ".git"))
    load_at(repository.unread(), "HEAD~1")
    with pytest.raises(Invalid, match="unknown key 'imag'"):
        load_at(repository.unread(), broken)
    assert not list((tmp_path / "temporary").iterdir())
    after = repository.git("status", "--porcelain", "--ignored"), sorted(os.listdir(repository.top / ".git"))
    assert after == before


HOLDS = """import sys
from pathlib import Path
from rorg.host.git_tree import extracted, resolved
root = Path(sys.argv[1])
with extracted(root, resolved(root, "HEAD")):
    print("there", flush=True)
    sys.stdin.read()
"""


def test_what_a_killed_command_left_behind_goes_with_the_next_one(repository, monkeypatch, tmp_path):
    (tmp_path / "temporary").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    monkeypatch.setattr(tempfile, "tempdir", None)
    repository.service("aa")
    repository.commit()

    def begun() -> subprocess.Popen[bytes]:
        words = [sys.executable, "-c", HOLDS, str(repository.tree)]
        process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert process.stdout.readline() == b"there\n"
        return process

    living, dying = begun(), begun()
    try:
        assert len(list((tmp_path / "temporary").iterdir())) == 2
        dying.kill()
        dying.wait(60)
        load_at(repository.unread(), "HEAD")
        assert len(list((tmp_path / "temporary").iterdir())) == 1, "that of a living one stays"
    finally:
        dying.kill()
        living.communicate(timeout=60)
    assert not list((tmp_path / "temporary").iterdir())


# -- rorg diff REV ---------------------------------------------------------------------------------------------


@pytest.fixture
def robot(tmp_path, monkeypatch):
    """A loop with its API, whose tree has three commits: `first`, HEAD~1 and HEAD; and what is not committed."""
    monkeypatch.chdir(tmp_path)
    found = RealRobot(tmp_path, "process", None, with_server=True)
    found.history = Repository(found.tree)
    states = [services("60"), {**services("61"), "more": {"always_on": True}}, services("62")]
    for name, state in zip(("first", "second", "third"), states, strict=True):
        write_tree(found.tree, state)
        found.history.commit()
        found.history.git("tag", name)
    (tmp_path / "allowed").touch()
    found.declare(services("63"))
    found.wait(lambda: {"base", "arm"} <= set(found.active()))
    found.settle()
    (tmp_path / "allowed").unlink()
    yield found
    found.close()


def services(seconds: str) -> dict:
    command = ["sh", "-c", f"exec sleep {seconds}", "--password", "hunter22"]
    arm = {"always_on": True, "interlock": {"file": str(Path("allowed").absolute())}, "priority": int(seconds)}
    return {"base": {"always_on": True, "command": command}, "arm": arm, "spare": {"needs": ["base"]}}


@pytest.mark.slow
def test_diff_to_a_commit_is_the_same_through_the_running_rorg_as_without(robot):
    lines = [("first",), ("HEAD~1", "-u"), ("HEAD~1", "-o", "wide"), (str(robot.tree), "HEAD", "-o", "json")]
    running = [rorg(robot, "diff", *line, code=1).stdout for line in lines]
    assert "exec sleep 63" in running[0]
    assert "exec sleep 60" in running[0].partition(" -> ")[2]
    assert "-/+ replace base" in running[0]
    assert "more" in running[2]
    assert "hunter" not in "".join(running)
    assert rorg(robot, "diff").stdout == "No differences.\n", "nothing of it was done"
    robot.stop()
    assert [rorg(robot, "diff", *line, code=1).stdout for line in lines] == running


@pytest.mark.slow
def test_a_state_that_is_none_is_told_with_what_is_near(robot):
    (robot.tree / "services/base.yaml").write_text("kind: Servise\n")
    broken = robot.history.commit()
    write_tree(robot.tree, services("63"))
    for running in (True, False):
        if not running:
            robot.stop()
        assert "'first'" in rorg(robot, "diff", "fisrt", code=2).stderr
        said = rorg(robot, "diff", broken[:9], code=2).stderr
        assert f"{broken[:7]}:services/base.yaml:1:7: error: unknown kind 'Servise'" in said
        assert rorg(robot, "diff", "--", "--help", code=2).stderr.startswith(
            "rorg: cannot read the manifests of '--help'"
        )
    assert "no such directory" in rorg(robot, "diff", "../first", code=2).stderr


def test_diff_outside_of_a_repository_says_what_is_missing(tmp_path, monkeypatch):
    found = RealRobot(tmp_path, "process", None)
    found.declare(services("60"))
    assert "is in no git repository" in rorg(found, "diff", str(found.tree), "HEAD", code=2).stderr
    found.close()


@pytest.mark.slow
def test_two_states_are_compared_service_by_service_without_an_engine(robot):
    said = rorg(robot, "diff", "first..HEAD~1", "--engine", "docker", code=1).stdout.splitlines()
    assert [line.split()[:3] for line in said[1:]] == [
        ["arm", "Service", "change"],
        ["base", "Service", "change"],
        ["more", "Service", "add"],
    ]
    assert said[1].endswith("priority: 60 -> 61")
    assert "exec sleep 60" in said[2].partition(" -> ")[0]
    assert "hunter" not in "".join(said)
    found = json.loads(rorg(robot, "diff", "HEAD~1..", "-o", "json", code=1).stdout)
    assert found["to"] == robot.history.git("rev-parse", "HEAD")
    assert {(c["name"], c["verb"]) for c in found["changes"]} >= {("more", "remove"), ("base", "change")}
    assert rorg(robot, "diff", "HEAD..HEAD").stdout == "No differences.\n"
    assert rorg(robot, "diff", "first..", "--service", "spare").stdout == "No differences.\n"
    told = rorg(robot, "diff", "first..", "-u", code=2).stderr
    command = told.rpartition("try `")[2].strip().rstrip("`")
    assert "sleep 60" in subprocess.check_output(["sh", "-c", command], cwd="/", text=True), "from any directory"


@pytest.mark.slow
def test_a_revision_is_named_by_its_number_as_well(robot):
    """The one of manifests that were never committed is not there for git."""
    Path("allowed").touch()
    robot.history.git("checkout", "--quiet", "--force", "second")
    number = newest(robot, lambda revision: not revision.dirty)
    write_tree(robot.tree, services("63"))
    dirty = newest(robot, lambda revision: revision.dirty)
    robot.settle()
    for running in (True, False):
        if not running:
            robot.stop()
        assert rorg(robot, "diff", number, code=1).stdout == rorg(robot, "diff", "second", code=1).stdout
        assert "not all committed" in rorg(robot, "diff", dirty, code=2).stderr
    lines = (f"first..{number}", "first..second")
    assert len({rorg(robot, "diff", line, code=1).stdout for line in lines}) == 1


def newest(robot, condition) -> str:
    """The number of the newest revision, once it is one of this kind."""
    revisions = Revisions(robot.loop.recorder.history)
    robot.wait(lambda: condition(revisions.last()))
    return str(revisions.last().number)
