"""Builds and runs the programs of the C++ client's tests."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Sequence
from contextlib import contextmanager
from pathlib import Path

from common import ROOT
from tools import tool

WARNINGS = ["-Wall", "-Wextra", "-Werror"]
SANITIZERS = {
    "address": [
        "-g1",
        "-fsanitize=address,undefined",
        "-fno-sanitize-recover=all",
        # What the address sanitizer sees as well, and half of the compiler's time.
        "-fno-sanitize=null,alignment,object-size,vptr",
    ],
    "thread": ["-g1", "-fsanitize=thread"],
}


def compile_all(programs: Sequence[Sequence[str | Path]]) -> None:
    """Compiles each from its words, all at the same time, with the client's header."""
    common = [tool("g++"), "-std=c++17", "-O0", "-pthread", "-I", ROOT / "clients/cpp/include"]
    builds = [subprocess.Popen([*common, *words]) for words in programs]
    assert [build.wait() for build in builds] == [0] * len(builds)


HOW = {
    "ASAN_OPTIONS": "detect_stack_use_after_return=1",
    "UBSAN_OPTIONS": "print_stacktrace=1",
    "TSAN_OPTIONS": "halt_on_error=1:die_after_fork=0",
}


@contextmanager
def program(path: Path, *words: str, **env: str):
    """The program, which must end well when the block has."""
    running = subprocess.Popen(
        [path, *words],
        text=True,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, **HOW, **env},
    )
    try:
        yield running
        _, errors = running.communicate(timeout=120)
        assert running.returncode == 0, errors  # one that is ending may be past its exit code
        assert not errors, errors
    finally:
        running.kill()


def heard(running: subprocess.Popen, word: str) -> None:
    """Returns when the program has said this."""
    line = running.stdout.readline().strip()
    assert line == word, line or running.communicate(timeout=60)[1]
