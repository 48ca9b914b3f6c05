"""The mutants themselves: what is changed, that a change is planted, and that each outcome is told from the others."""

from __future__ import annotations

import ast
import os
import subprocess
import sys

import pytest
from common import ASSURANCE, ROOT, SUPPORT
from mutants.hunt import equivalents, key_of
from mutants.operators import Mutant, mutants_of
from mutants.plant import Core

CORE = Core()
CASES = "tests/unit/core/test_planner_cases.py::test_plan"
MODULE = '''
LIMIT = 3

def longer(words: list[str | None], most: int = 2) -> bool:
    """A documented function."""
    found = 0
    for word in words:
        if not word or word == "the":
            continue
        found += len(word) + 1
    assert found is not None
    if found < 0:
        raise ValueError(f"{found + 1}")
    return found > most
'''
CHANGES = [
    "3 -> 4",
    "2 -> 3",
    "found = 0 -> pass",
    "0 -> 1",
    "not word or word == 'the' -> True",
    "not word or word == 'the' -> not word and word == 'the'",
    "not word -> False",
    "word == 'the' -> False",
    "'the' -> 'the!'",
    "continue -> pass",
    "found += len(word) + 1 -> pass",
    "len(word) + 1 -> len(word) - 1",
    "1 -> 2",
    "found < 0 -> True",
    "found < 0 -> False",
    "found < 0 -> found <= 0",
    "0 -> 1",
    "return found > most -> return None",
    "found > most -> found >= most",
    "found > most -> found <= most",
]


def all_mutants(file: str) -> list[Mutant]:
    return mutants_of(file, ast.parse(CORE.paths[file].read_text()))


def named(file: str, change: str, which: int = 0) -> str:
    """The mutant of a file with this change, counted from 0 if there are several."""
    return [m.name for m in all_mutants(file) if m.change == change][which]


def outcomes(names: list[str], tests: list[str]) -> dict[str, str]:
    """What becomes of mutants when only these tests run."""
    paths = os.pathsep.join(map(str, (ASSURANCE, SUPPORT, ROOT, ROOT / "clients/python")))
    done = subprocess.run(
        [sys.executable, "-m", "mutants.hunt", *names],
        env={**os.environ, "PYTHONPATH": paths, "MUTANTS_TESTS": " ".join(tests)},
        capture_output=True,
        text=True,
        check=False,
    )
    lines = [line.split() for line in done.stdout.splitlines()]
    return {line[1]: line[0] for line in lines if len(line) > 1 and line[1] in names}


def test_each_small_change_of_what_decides_is_a_mutant():
    assert [m.change for m in mutants_of("longer.py", ast.parse(MODULE))] == CHANGES


def test_names_of_mutants_are_unique():
    names = [m.name for file in CORE.paths for m in all_mutants(file)]
    assert len(names) == len({*names}) > 5000


def test_each_mutant_that_is_called_equivalent_exists():
    mutants = {key_of(m, CORE) for file in CORE.paths for m in all_mutants(file)}
    assert not [key for key in equivalents() if key not in mutants]


@pytest.mark.slow
def test_a_mutant_is_killed_survives_or_hangs():
    """Of code, of a constant of a module, of the default of a field; unseen by these tests; and one without an end."""
    found = {
        named("gates.py", "until is not None and (not view.has_come(until)) -> False"): "killed",
        named("pressure.py", "0.02 -> 1.02"): "killed",
        named("pressure.py", "False -> True", 1): "killed",
        named("priorities.py", "101 -> 102"): "survived",
        named("pressure.py", "level -= 1 -> pass"): "timeout",
    }
    rules = "tests/unit/core/test_pressure.py::test_"
    tests = [
        f"{CASES}[unwanted_lingers]",
        f"{rules}a_measure_is_undone_after_calm_has_lasted",
        f"{rules}freeing_helps_if_it_is_a_fair_part_of_the_excess",
    ]
    assert outcomes([*found], [*tests, f"{rules}a_measure_shows_its_effect_before_the_next_one"]) == found
