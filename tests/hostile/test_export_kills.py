"""`rorg export` that is killed: each file is the old one or the new one, and the next export clears up."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest
from killed_commands import files, run
from robots import write_tree

COMMAND = ("export", "compose", "tree", "--output", "out/compose.yaml")


def declare(folder: Path, password: str) -> None:
    environment = {"PASSWORD": password}
    write_tree(folder / "tree", {"nav": {"secrets": ["PASSWORD"], "container": {"environment": environment}}})


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "robot").mkdir()
    declare(tmp_path / "robot", "one")
    return tmp_path / "robot"


@pytest.mark.slow
def test_a_file_that_is_exported_over_is_the_old_one_or_the_new_one(folder):
    assert run(folder, "9999", *COMMAND) == 0
    old = files(folder / "out")
    declare(folder, "two")
    assert run(folder, "9999", *COMMAND[:-1], "new/compose.yaml") == 0
    new = files(folder / "new")
    assert old != new
    for step in itertools.count():
        code = run(folder, str(step), *COMMAND, "--force")
        found = files(folder / "out")
        shown = {name: text for name, text in found.items() if not Path(name).name.startswith(".") or name in old}
        assert shown.keys() == old.keys(), step
        assert all(text in (old[name], new[name]) for name, text in shown.items()), step
        if code == 0:
            break
        assert code == -9
    assert step > 2
    assert found == new
