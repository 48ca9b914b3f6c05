"""The invariants catch defects that are planted in a copy of rorg: some of them here, all by `make defects`."""

from __future__ import annotations

import os
import random

import pytest
from bounded.defects import DEFECTS
from bounded.defects_of_undo import DEFECTS_OF_UNDO
from bounded.invariants import INVARIANTS
from bounded.planted import ROOT, caught
from bounded.walks import Tally, broken

WHOLE = os.environ.get("RORG_TEST_DEFECTS") == "all"
SEED = 1
OTHERS = [d for d in DEFECTS if d not in DEFECTS_OF_UNDO]
SOME = DEFECTS if WHOLE else [*random.Random(SEED).sample(OTHERS, 4), *random.Random(SEED).sample(DEFECTS_OF_UNDO, 2)]


@pytest.mark.slow
@pytest.mark.parametrize("defect", SOME, ids=lambda defect: defect.name.replace(" ", "_"))
def test_a_planted_defect_is_caught(defect, tmp_path):
    name = caught(defect, tmp_path)
    assert name in defect.caught_by, f"{defect.name}: {name or 'nothing catches it'}"


def test_each_defect_can_be_planted():
    """What it changes occurs once in its file."""
    texts = {d.name: (ROOT / "rorg" / d.file).read_text().count(d.old) for d in DEFECTS}
    assert not {name: count for name, count in texts.items() if count != 1}
    assert not [d.name for d in DEFECTS if d.old == d.new]


def test_the_walks_of_defects_keep_every_promise_without_them():
    found = {d.name: str(broken(d.walk, Tally())) for d in DEFECTS_OF_UNDO}
    assert not {name: why for name, why in found.items() if why != "None"}


def test_each_defect_names_invariants_that_exist():
    known = {*INVARIANTS, "the plan keeps its rules", "it converges in bounded passes"}
    assert len(DEFECTS) >= 30
    assert not {name for defect in DEFECTS for name in defect.caught_by} - known
    assert len({defect.name for defect in DEFECTS}) == len(DEFECTS)
