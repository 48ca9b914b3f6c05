"""Tests that take too long for `make test` still begin."""

from __future__ import annotations

import subprocess
import sys

import pytest
from common import ROOT


@pytest.mark.slow
@pytest.mark.parametrize("folder", ["tests/bench", "tests/assurance/vm"])
def test_the_long_tests_can_be_imported(folder):
    words = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-o", "norecursedirs=x", folder]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout
