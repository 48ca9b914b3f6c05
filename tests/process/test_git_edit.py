"""Commits that restore earlier files, in real repositories."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import tempfile
from pathlib import Path

import pytest

from rorg.errors import Refused
from rorg.host.git_edit import Restoring, changed, top_of, unknown
from rorg.host.person import Person

ANN = {
    "GIT_AUTHOR_NAME": "Ann",
    "GIT_AUTHOR_EMAIL": "ann@lab",
    "GIT_COMMITTER_NAME": "Ann",
    "GIT_COMMITTER_EMAIL": "ann@lab",
}
NOBODY = Person(os.getuid(), os.getgid(), "bob", "")


def git(folder: Path, *words: str) -> str:
    done = subprocess.run(["git", "-C", folder, *words], env={**os.environ, **ANN}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def write(folder: Path, message: str, **files: str | None) -> str:
    """A commit in which files (`a__b` for a/b.yaml) are so, or are not there; its hash."""
    for name, text in files.items():
        path = folder / f"{name.replace('__', '/')}.yaml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink() if text is None else path.write_text(text)
    git(folder, "add", "--all")
    git(folder, "commit", "--quiet", "--message", message)
    return git(folder, "rev-parse", "HEAD")


@pytest.fixture
def repository(tmp_path) -> Path:
    git(tmp_path, "init", "--quiet")
    return tmp_path


@pytest.fixture
def first(repository) -> str:
    """The first of two commits: one file is changed, one removed, one new; `notes` lies beside."""
    found = write(repository, "one", tree__a="1", tree__old="old", notes="1")
    write(repository, "two", tree__a="2", tree__old=None, tree__new="new", notes="2")
    return found


def files(folder: Path) -> dict[str, str]:
    return {str(p.relative_to(folder)): p.read_text() for p in sorted(folder.rglob("*.yaml"))}


WAS = {"notes.yaml": "2", "tree/a.yaml": "1", "tree/old.yaml": "old"}
"""With the directory `tree` as in the first."""


def test_a_commit_restores_a_directory_and_nothing_else(repository, first):
    before, restoring = files(repository), Restoring(repository, first, ("tree",), "Back")
    made = restoring.commit(NOBODY, ANN)
    assert files(repository) == before
    assert not git(repository, "status", "--porcelain")
    restoring.take(made)
    assert files(repository) == WAS
    assert not git(repository, "status", "--porcelain")
    assert git(repository, "log", "-1", "--format=%H %an %ce %s") == f"{made} Ann ann@lab Back"


def test_the_commands_do_the_same(repository, first):
    """Pasted into a shell."""
    lines = Restoring(repository, first, ("tree",), "Ann's $(way) back").commands()
    subprocess.run(["sh", "-ec", "\n".join(lines)], env={**os.environ, **ANN}, cwd="/", check=True, capture_output=True)
    assert files(repository) == WAS
    assert not git(repository, "status", "--porcelain")
    assert git(repository, "log", "-1", "--format=%s") == "Ann's $(way) back"


@pytest.mark.parametrize("path", ["tree/new.yaml", "tree/old.yaml", "tree/a.yaml", "."])
def test_the_commands_take_files_that_come_and_that_go(repository, first, path):
    restoring = Restoring(repository, first, (path,), "Back")
    tree = git(repository, "rev-parse", f"{restoring.commit(NOBODY, ANN)}^{{tree}}")
    lines = [line.removeprefix("git ") for line in restoring.commands(clone=True)]
    assert lines.pop() == "push"
    for line in lines:
        subprocess.run(f"git {line}", shell=True, check=True, cwd=repository, env={**os.environ, **ANN})
    assert git(repository, "rev-parse", "HEAD^{tree}") == tree


def test_odd_names_are_paths(repository):
    path = "tree/*[a] 'b'"
    first = write(repository, "one", **{path.replace("/", "__"): "1", "tree__ab": "1"})
    write(repository, "two", **{path.replace("/", "__"): "2", "tree__ab": "2"})
    restoring = Restoring(repository, first, (f"{path}.yaml",), "Back")
    lines = restoring.commands()
    restoring.take(restoring.commit(NOBODY, ANN))
    assert files(repository) == {f"{path}.yaml": "1", "tree/ab.yaml": "2"}
    git(repository, "reset", "--quiet", "--hard", "HEAD^")
    subprocess.run(["sh", "-ec", "\n".join(lines)], env={**os.environ, **ANN}, check=True, capture_output=True)
    assert files(repository) == {f"{path}.yaml": "1", "tree/ab.yaml": "2"}


def test_what_would_change_nothing_is_no_commit(repository, first):
    head = git(repository, "rev-parse", "HEAD")
    assert Restoring(repository, head, ("tree",), "Back").commit(NOBODY, ANN) == ""
    nowhere = Restoring(repository, first, ("nowhere",), "Back")
    assert nowhere.commit(NOBODY, ANN) == ""
    assert nowhere.commands() == []


def test_what_others_do_meanwhile_is_not_undone(repository, first):
    restoring = Restoring(repository, first, ("tree",), "Back")
    made = restoring.commit(NOBODY, ANN)
    head = write(repository, "three", notes="3")
    with pytest.raises(Refused, match="fast-forward"):
        restoring.take(made)
    assert git(repository, "rev-parse", "HEAD") == head


def test_what_is_staged_elsewhere_stays_staged(repository, first):
    (repository / "notes.yaml").write_text("3")
    git(repository, "add", "notes.yaml")
    restoring = Restoring(repository, first, ("tree",), "Back")
    restoring.take(restoring.commit(NOBODY, ANN))
    assert git(repository, "status", "--porcelain") == "M  notes.yaml"
    assert git(repository, "log", "-1", "--format=%H", "--", "notes.yaml") != git(repository, "rev-parse", "HEAD")


def test_what_is_not_committed_is_named_and_never_lost(repository, first):
    (repository / "tree/a.yaml").write_text("mine")
    (repository / "tree/old.yaml").write_text("mine too")
    restoring = Restoring(repository, first, ("tree",), "Back")
    assert changed(repository, repository / "tree") == ["tree/a.yaml"]
    assert unknown(repository, ["tree/a.yaml", "tree/old.yaml"]) == ["tree/old.yaml"]
    with pytest.raises(Refused, match="would be overwritten"):
        restoring.take(restoring.commit(NOBODY, ANN))
    assert (repository / "tree/a.yaml").read_text() == "mine"
    assert (repository / "tree/old.yaml").read_text() == "mine too"


def test_it_is_by_whom_git_knows_else_by_the_user(repository, first, tmp_path_factory, monkeypatch):
    home = tmp_path_factory.mktemp("home")
    monkeypatch.setenv("HOME", str(tmp_path_factory.mktemp("nobody")))
    (home / ".gitconfig").write_text("[user]\nname = Cleo\nemail = cleo@lab\n")
    restoring = Restoring(repository, first, ("tree",), "Back")

    def author(person: Person) -> str:
        return git(repository, "log", "-1", "--format=%an <%ae>, %cn", restoring.commit(person, {}))

    assert author(NOBODY._replace(home=str(home))) == "Cleo <cleo@lab>, Cleo"
    assert author(NOBODY) == f"bob <bob@{socket.gethostname()}>, bob"
    git(repository, "config", "user.name", "Dan")
    assert author(NOBODY) == f"Dan <bob@{socket.gethostname()}>, Dan"
    git(repository, "config", "user.email", "dan@lab")
    assert author(NOBODY) == "Dan <dan@lab>, Dan"


def test_a_remedy_works_as_printed_from_any_directory(tmp_path, monkeypatch):
    (tmp_path / "a robot's").mkdir()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(Refused) as told:
        top_of(Path("a robot's"))
    command = told.value.remedy.split("`")[3]
    subprocess.run(["sh", "-c", command], cwd="/", check=True, capture_output=True)
    assert top_of(Path("a robot's")) == tmp_path / "a robot's"


def test_no_repository_is_told(tmp_path):
    with pytest.raises(Refused, match="`git rev-parse` ends with 128; try `git -C"):
        Restoring(tmp_path, "abc", (".",), "Back").commit(NOBODY, ANN)
    with pytest.raises(Refused, match="is in no git repository that this user may read; try"):
        top_of(tmp_path)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may act for another user")
def test_in_a_clone_of_another_user_all_stays_theirs(first, repository):
    with tempfile.TemporaryDirectory() as place:
        clone = Path(place) / "clone"
        shutil.copytree(repository, clone)
        for path in (Path(place), clone, *clone.rglob("*")):
            os.chown(path, 47_002, 47_002)
        restoring = Restoring(clone, first, ("tree",), "Back")
        restoring.take(restoring.commit(NOBODY, ANN))
        assert files(clone) == WAS
        assert {path.stat().st_uid for path in clone.rglob("*")} == {47_002}
