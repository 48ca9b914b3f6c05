"""The page on trying a policy, run from its own commands, on the process engine."""

from __future__ import annotations

import pages
import pytest
from common import ROOT
from page_preparation import PREPARE

STEPS = pages.steps(ROOT / "docs/how-to/simulate.md")


@pytest.mark.slow
def test_the_page_word_for_word(tmp_path):
    pages.run(STEPS, PREPARE, tmp_path, RORG_ENGINE="process")
