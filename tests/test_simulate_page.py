"""The page on trying a policy, run from its own commands, on the process engine."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pages
from conftest import ROOT
from test_how_to import PREPARE

STEPS = pages.steps(ROOT / "docs/how-to/simulate.md")


def test_the_page_word_for_word(tmp_path):
    home = tmp_path / "home"
    home.mkdir()
    (tmp_path / "script").write_text(PREPARE + pages.script(STEPS, str(tmp_path / "state/run/rorg.sock")))
    done = subprocess.run(
        ["bash", tmp_path / "script"],
        cwd=home,
        env={
            "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
            "HOME": str(home),
            "RORG_ENGINE": "process",
            "RORG_STATE_DIR": str(tmp_path / "state"),
        },
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
        timeout=200,
    )
    told = pages.parts(done.stdout)
    assert len(STEPS) > 10
    assert str(len(STEPS) - 1) in told, done.stdout[-3000:]
    pages.check(STEPS, told, done.stdout)
