"""The page on coming from Compose, run from its own commands on Docker."""

from __future__ import annotations

import pages
import pytest
from busybox import build_busybox
from common import ROOT
from page_preparation import PREPARE

STEPS = pages.steps(ROOT / "docs/how-to/from-compose.md")


@pytest.mark.docker
def test_the_page_word_for_word(dockerd, tmp_path):
    build_busybox(dockerd.host, tmp_path / "busybox")
    pages.run(STEPS, PREPARE, tmp_path, DOCKER_HOST=dockerd.host)
