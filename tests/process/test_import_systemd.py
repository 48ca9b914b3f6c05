"""`rorg import systemd` and `rorg import roslaunch` as commands."""

from __future__ import annotations

import json
import os

import commands
import pytest


@pytest.mark.slow
def test_the_commands_write_once_and_only_what_is_whole(tmp_path):
    def rorg(line: str):
        return commands.run(line.split(), dict(os.environ), tmp_path)

    (tmp_path / "nav.service").write_text("[Service]\nExecStart=/x\n")
    (tmp_path / "bad.service").write_text("[Service]\nType=forking\nExecStart=/x\n")
    done = rorg("import systemd nav.service bad.service")
    assert done.returncode == 2
    assert "bad.service:2:1: error: Type=forking" in done.stderr
    assert not (tmp_path / "manifests").exists()
    written = rorg("import systemd nav.service")
    assert (written.returncode, written.stderr.splitlines()[-1]) == (0, "next: rorg run --engine process manifests")
    assert "next: rorg run other" in rorg("import systemd nav.service --image debian --output other").stderr
    again = rorg("import systemd nav.service")
    assert again.returncode == 5
    assert "--force" in again.stderr
    told = json.loads(rorg("import systemd nav.service --force -o json").stdout)
    assert told["files"] == ["manifests/services/nav.yaml"]
    assert rorg("validate").returncode == 0
    assert (tmp_path / "manifests/schemas/service.json").exists()
