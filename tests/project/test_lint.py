"""Ruff finds no mistake and no other form, mypy no type that does not fit. None of these tests is marked slow, so that
`make test` always runs them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from common import ROOT

COMMANDS = {
    "mistakes": "ruff check .",
    "forgotten f-strings": "ruff check --preview --select RUF027 rorg clients",
    "form": "ruff format --check .",
    "types": "mypy",
}


@pytest.mark.parametrize("command", COMMANDS.values(), ids=COMMANDS)
def test_a_tool_finds_nothing(command):
    tool, *words = command.split()
    done = subprocess.run([Path(sys.executable).with_name(tool), *words], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_make_runs_the_same():
    lines = (ROOT / "Makefile").read_text().splitlines()
    called = [line.removeprefix("\t$(BIN)/") for line in lines if line.startswith(("\t$(BIN)/ruff", "\t$(BIN)/mypy"))]
    assert called == list(COMMANDS.values())
