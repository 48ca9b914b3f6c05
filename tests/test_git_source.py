"""Manifests in git: whose repository it is, and a repository that rorg follows."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest
from robots import write_tree

from rorg.api.manifest_change import ManifestChange
from rorg.host.git import Commit, commit, head, revision

OTHER = 47_003
"""The number of a user that the machine does not know."""
root_only = pytest.mark.skipif(os.geteuid() != 0, reason="only root acts for others")


def git(folder: Path, *words: str, **more) -> str:
    who = ("-c", "user.name=Anna", "-c", "user.email=anna@example.org", "-c", "init.defaultBranch=main")
    done = subprocess.run(
        ["git", *who, "-C", str(folder), *words],
        text=True,
        stdout=subprocess.PIPE,
        env={"PATH": os.environ["PATH"], "HOME": "/nowhere"},
        **more,
    )
    assert done.returncode == 0, words
    return done.stdout.strip()


def committed(folder: Path, message: str = "Begin", **more) -> str:
    """The hash of a commit of all that is there."""
    git(folder, "add", "--all", **more)
    git(folder, "commit", "--quiet", "--allow-empty", "--message", message, **more)
    return git(folder, "rev-parse", "HEAD", **more)


@pytest.fixture
def tree(tmp_path):
    found = write_tree(tmp_path / "robot", {"camera": {}})
    git(found, "init", "--quiet")
    return found


# -- what git says of a tree -----------------------------------------------------------------------------------


def test_the_head_of_a_tree(tree):
    assert head(tree) is None, "before the first commit"
    made = committed(tree, "A camera\n\nfor the arm")
    found = head(tree / "services")
    assert found == Commit(made, "Anna", "A camera", found.at, False)
    assert found.at.startswith("20")
    assert found.at.endswith("Z")
    (tree / "services/camera.yaml").write_text("x")
    assert head(tree).dirty
    assert head(tree.parent) is None


# -- another user's repository ---------------------------------------------------------------------------------


@pytest.fixture
def theirs():
    """The clone of another user, whose hooks and filters tell who runs them."""
    folder = Path(tempfile.mkdtemp(prefix="rorg-theirs-"))
    folder.chmod(0o755)
    found = write_tree(folder / "robot", {"camera": {}})
    told = found.parent / "told"
    git(found, "init", "--quiet")
    tells = f"id -u >> {told}; cat"
    git(found, "config", "filter.tells.clean", tells)
    git(found, "config", "filter.tells.smudge", tells)
    (found / ".gitattributes").write_text("*.yaml filter=tells\n")
    hook = found / ".git/hooks/pre-commit"
    hook.write_text(f"#!/bin/sh\nid -u >> {told}\n")
    hook.chmod(0o755)
    for path in (folder, *folder.rglob("*")):
        os.chown(path, OTHER, OTHER)
    committed(found, user=OTHER, group=OTHER)
    told.unlink()
    yield found
    shutil.rmtree(folder)


def who_ran(tree: Path) -> set[str]:
    told = tree.parent / "told"
    return set(told.read_text().split()) if told.exists() else set()


@root_only
def test_root_asks_another_users_repository_in_their_name(theirs):
    made = git(theirs, "rev-parse", "HEAD", user=OTHER, group=OTHER)
    assert made.startswith(revision(theirs))
    assert head(theirs).commit == made
    os.utime(theirs / "services/camera.yaml", (1, 1))  # so that git looks at what is in it, through the filter
    assert not head(theirs).dirty
    assert who_ran(theirs) == {str(OTHER)}


@root_only
def test_what_root_changes_in_their_tree_is_theirs(theirs):
    for name, text in (("camera", "a: 1\n"), ("arm", "b: 2\n")):
        change = ManifestChange(f"services/{name}.yaml", None, "", f"Change {name}", "Bob")
        change.carry_out(theirs, theirs.parent / "note", text)
    log = git(theirs, "log", "--format=%an %s", user=OTHER, group=OTHER).splitlines()
    assert log == ["Bob Change arm", "Bob Change camera", "Anna Begin"]
    assert who_ran(theirs) == {str(OTHER)}
    files = [p for p in theirs.rglob("*") if p.lstat().st_uid != OTHER]
    assert not files


@root_only
def test_a_new_folder_in_their_tree_is_theirs(theirs):
    ManifestChange("groups/all.yaml", None, "", "All", "Bob").carry_out(theirs, theirs.parent / "note", "c: 3\n")
    assert {p.stat().st_uid for p in (theirs / "groups", theirs / "groups/all.yaml")} == {OTHER}
    assert commit(theirs, theirs / "groups/all.yaml", "Bob", "Nothing") is False
