"""What conftest.py refuses to the tests of this folder."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable

import commands
import pytest

WAYS: dict[str, Callable[[], object]] = {
    "subprocess": lambda: subprocess.run([sys.executable, "-c", ""]),
    "fork": lambda: os.fork() or os._exit(0),
    "spawn": lambda: os.posix_spawn(sys.executable, [sys.executable, "-c", ""], {}),
    "shell": lambda: os.system("true"),
    "commands of tests": lambda: commands.rorg("--version"),
}


@pytest.mark.parametrize("way", WAYS)
def test_no_test_of_unit_starts_a_process(way, processes):
    with pytest.raises(BaseException, match="move it to tests/process"):
        WAYS[way]()
    assert processes
    processes.clear()  # or this test fails too
