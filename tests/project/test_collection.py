"""Tests that take too long for `make test` still begin, and all tests are found in one order."""

from __future__ import annotations

import os
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


@pytest.mark.slow
def test_every_worker_finds_the_tests_in_the_same_order():
    """pytest-xdist runs nothing otherwise. Sets and folders have an order of their own in each process."""
    words = [sys.executable, "-m", "pytest", "--collect-only"]
    orders = set()
    for seed in ("1", "2"):
        done = subprocess.run(
            words, cwd=ROOT, env={**os.environ, "PYTHONHASHSEED": seed}, capture_output=True, text=True, timeout=300
        )
        assert done.returncode == 0, done.stdout
        orders.add("\n".join(line for line in done.stdout.splitlines() if "::" in line))
    assert all(len(order) > 100_000 for order in orders)
    assert len(orders) == 1


@pytest.mark.slow
def test_a_parameter_of_any_name_says_which_engine_a_test_ran_on():
    words = [sys.executable, "-m", "pytest", "-k", "copied and process", "tests/docker/test_robot_identity.py"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert "tests passed by engine: 1 on process; " in done.stdout
