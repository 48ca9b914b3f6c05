"""A git that does not answer in time says nothing: it is not taken for "no repository" or "no changes"."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from rorg.errors import Invalid, TimedOut
from rorg.host import git_objects
from rorg.host.git import head, revision
from rorg.host.git_edit import top_of
from rorg.host.git_tree import extracted, resolved


@pytest.fixture
def tree(tmp_path):
    """A repository with a commit."""
    words = ("git", "-C", str(tmp_path), "-c", "user.name=me", "-c", "user.email=me@lab")
    (tmp_path / "map").write_text("1")
    for command in (("init", "-q"), ("add", "map"), ("commit", "-qm", "first")):
        subprocess.run([*words, *command], check=True)
    return tmp_path


def freeze(tree: Path) -> None:
    """Every git waits for somebody who writes into this pipe."""
    (tree / ".git/HEAD").unlink()
    os.mkfifo(tree / ".git/HEAD")


def test_no_answer_is_not_taken_for_no_repository(tree, monkeypatch):
    monkeypatch.setattr(git_objects, "PATIENCE", 0.3)
    commit = resolved(tree, "HEAD")
    with pytest.raises(Invalid, match="knows no such commit"):
        resolved(tree, "nosuch")
    freeze(tree)
    with pytest.raises(TimedOut, match=r"no answer to `git rev-parse` within 0\.3 s; try again"):
        resolved(tree, "HEAD")
    with pytest.raises(TimedOut), extracted(tree, commit):
        pass
    with pytest.raises(TimedOut):
        top_of(tree)


@pytest.mark.slow
def test_a_tree_whose_status_is_not_known_counts_as_changed(tree):
    """git asks a filter of the repository about a file whose time has changed, and that takes too long."""
    assert not revision(tree).endswith("+")
    (tree / ".gitattributes").write_text("map filter=slow\n")
    subprocess.run(["git", "-C", str(tree), "config", "filter.slow.clean", "sleep 600"], check=True)
    (tree / ".git/info/exclude").write_text(".gitattributes\n")
    os.utime(tree / "map", (1, 1))
    found = head(tree)
    assert found is not None
    assert found.dirty
