"""Reference pages are what the code says; links lead somewhere."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest
from conftest import ROOT

PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md")), ROOT / "manifests" / "README.md"]


@pytest.mark.parametrize("script", ["reference/generate.py", "explanation/import_graph.py"])
def test_what_is_generated_is_current(script):
    subprocess.run([sys.executable, str(ROOT / "docs" / script), "--check"], check=True)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    for link in re.findall(r"\]\(([^)#]+)", page.read_text()):
        if "://" not in link:
            assert (page.parent / link).exists(), link


def test_the_files_that_contributing_names_are_there():
    for name in re.findall(r"`((?:rorg|tests|docs)/[\w/.-]+)`", (ROOT / "CONTRIBUTING.md").read_text()):
        assert (ROOT / name).exists() or "NAME" in name, name
