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


def test_each_boundary_of_the_threat_model_is_held_by_a_test_that_is_there():
    """Of each row of the table, and of whatever else names a test."""
    text = (ROOT / "SECURITY.md").read_text()
    table = text.partition("| boundary |")[2].partition("\n\n")[0].splitlines()[2:]
    assert len(table) > 20
    for row in table:
        assert "::test_" in row, f"nothing holds {row}"
    for file, name in re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", text):
        assert re.search(rf"^(async )?def {name}\(", (ROOT / file).read_text(), re.MULTILINE), f"{file}::{name}"
    assert text.count("::test_") == len(re.findall(r"`tests/[\w/]+\.py::test_\w+`", text)), "one is written otherwise"
