"""Table I of the paper as pages: each is run from its own commands, on Docker, in one repository and one after the
other, as somebody works through them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pages
import pytest
from busybox import build_busybox
from common import ROOT
from page_preparation import PREPARE

PAGES = ("deploy", "update", "roll-back", "change-configuration", "develop")
STEPS = {name: pages.steps(ROOT / f"docs/how-to/{name}.md") for name in PAGES}
AT_THE_END = f"""
echo '{pages.SAID}built'
rorg events --kind image-ready
echo '{pages.SAID}end'
"""


@pytest.fixture(scope="module")
def told(dockerd, tmp_path_factory) -> str:
    """What a shell says that works through all pages."""
    folder = tmp_path_factory.mktemp("pages")
    build_busybox(dockerd.host, folder / "busybox")
    home = folder / "home"
    home.mkdir()
    steps = [step for name in PAGES for step in STEPS[name]]
    (folder / "script").write_text(PREPARE + pages.script(steps, str(folder / "state/run/rorg.sock")) + AT_THE_END)
    environment = {
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "HOME": str(home),
        "DOCKER_HOST": dockerd.host,
        "RORG_STATE_DIR": str(folder / "state"),
    }
    done = subprocess.run(
        ["bash", folder / "script"],
        cwd=home,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
        timeout=300,
    )
    return done.stdout


@pytest.mark.parametrize("page", PAGES)
def test_a_page_word_for_word(told, page):
    first = sum(len(STEPS[name]) for name in PAGES[: PAGES.index(page)])
    parts = pages.parts(told)
    mine = {str(number): parts.get(str(first + number), "") for number in range(len(STEPS[page]))}
    assert len(mine) > 3
    assert str(first + len(STEPS[page]) - 1) in parts, told[-3000:]
    pages.check(STEPS[page], mine, told)


def test_the_image_of_before_is_used_as_it_was(told):
    """The running rorg built the second version and the third; the first one came back, and was used ever since."""
    assert pages.parts(told).get("built", "").count(" built in ") == 2, told[-3000:]
