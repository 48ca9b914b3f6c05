"""The invariants catch defects that are planted in a copy of rorg: some of them here, all by `make defects`."""

from __future__ import annotations

import os
import random

import pytest
from bounded.defects import DEFECTS
from bounded.invariants import INVARIANTS
from bounded.planted import caught

WHOLE = os.environ.get("RORG_TEST_DEFECTS") == "all"
SEED = 1
SOME = DEFECTS if WHOLE else random.Random(SEED).sample(DEFECTS, 4)


@pytest.mark.parametrize("defect", SOME, ids=lambda defect: defect.name.replace(" ", "_"))
def test_a_planted_defect_is_caught(defect, tmp_path):
    name = caught(defect, tmp_path)
    assert name in defect.caught_by, f"{defect.name}: {name or 'nothing catches it'}"


def test_each_defect_names_invariants_that_exist():
    known = {*INVARIANTS, "the plan keeps its rules", "it converges in bounded passes"}
    assert len(DEFECTS) >= 30
    assert not {name for defect in DEFECTS for name in defect.caught_by} - known
    assert len({defect.name for defect in DEFECTS}) == len(DEFECTS)
