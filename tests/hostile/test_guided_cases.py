"""Inputs that `make fuzz-guided` has found to break a reader of rorg break it no more."""

from __future__ import annotations

from pathlib import Path

import pytest
from common import ROOT
from fuzzing import HUNG, MOST_CPU, MOST_MEMORY, Figures, ended_after, measured
from guided import guided_servers  # noqa: F401 - it adds its targets
from guided.guided_fuzzing import NAMES
from guided.guided_targets import TARGETS, Target, make

CASES = sorted((ROOT / "tests/cases/fuzz").glob("*/*"))


@pytest.fixture(scope="module")
def targets(tmp_path_factory):
    made: dict[str, Target] = {}

    def target(name: str) -> Target:
        if name not in made:
            made[name] = make(name, tmp_path_factory.mktemp(name))
        return made[name]

    yield target
    for one in made.values():
        one.close()


def attempt(target: Target, data: bytes) -> None:
    with ended_after(HUNG), measured(Figures()) as used:
        target.attempt(data)
    assert used.cpu < MOST_CPU
    assert used.memory < MOST_MEMORY


def test_every_target_is_fuzzed():
    assert sorted(NAMES) == sorted(TARGETS)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_target_takes_what_it_begins_with(name, targets):
    for data in targets(name).seeds():
        attempt(targets(name), data)


@pytest.mark.parametrize("path", CASES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_what_was_found_breaks_nothing(path: Path, targets):
    attempt(targets(path.parent.name), path.read_bytes())
