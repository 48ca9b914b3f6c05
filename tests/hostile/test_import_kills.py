"""`rorg import` that is killed: a new directory of manifests is there whole or not at all, and each file is whole."""

from __future__ import annotations

import itertools
import os

import pytest
from killed_commands import files, run

COMPOSE = """\
services:
  nav: {image: x, secrets: [token]}
  lidar: {image: y, build: {dockerfile_inline: "FROM z"}}
secrets: {token: {environment: HOME}}
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "compose.yaml").write_text(COMPOSE)
    return tmp_path / "robot"


@pytest.mark.slow
def test_a_new_directory_appears_at_once(folder):
    assert run(folder, "9999", "import", "compose") == 0
    whole = files(folder / "manifests")
    assert os.stat(folder / "manifests/secrets/token").st_mode & 0o777 == 0o600
    (folder / "manifests").rename(folder / "first")
    for step in itertools.chain(range(4), itertools.count(4, 5)):
        code = run(folder, str(step), "import", "compose")
        if code == 0:
            break
        assert code == -9
        found = folder / "manifests"
        assert not found.exists() or files(found) == whole, step
        if found.exists():
            found.rename(folder / f"done{step}")
    assert step > 20, "it has more steps than that"
    assert files(folder / "manifests") == whole
    assert not [path.name for path in folder.iterdir() if ".part" in path.name], "the next import clears up"


@pytest.mark.slow
def test_a_file_that_is_written_over_is_the_old_one_or_the_new_one(folder):
    assert run(folder, "9999", "import", "compose") == 0
    old = files(folder / "manifests")
    (folder / "manifests" / "own.txt").write_text("mine")
    (folder / "compose.yaml").write_text(COMPOSE.replace("image: x", "image: changed"))
    for step in itertools.count(0, 7):
        code = run(folder, str(step), "import", "compose", "--force")
        found = {name: text for name, text in files(folder / "manifests").items() if ".part" not in name}
        assert found.pop("own.txt") == "mine"
        assert {**found, "services/nav.yaml": ""} == {**old, "services/nav.yaml": ""}, step
        before, now = old["services/nav.yaml"], found["services/nav.yaml"]
        assert now in (before, before.replace("image: x", "image: changed"))
        if code == 0:
            break
    assert now != before
    assert not list((folder / "manifests").glob(".*"))
