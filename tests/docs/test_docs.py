"""Reference pages are what the code says; links lead somewhere."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from common import ROOT

PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md")), ROOT / "manifests" / "README.md"]


@pytest.mark.parametrize("script", ["reference/generate.py", "explanation/import_graph.py"])
def test_what_is_generated_is_current(script):
    subprocess.run([sys.executable, str(ROOT / "docs" / script), "--check"], check=True)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    for link in re.findall(r"\]\(([^)#]+)", page.read_text()):
        if "://" not in link:
            assert (page.parent / link).exists(), link


CODE = re.compile(r"```.*?```", re.DOTALL)


def anchors(page: Path) -> set[str]:
    """What a link to a part of a page may name: its headings, as code hosts spell them, and its own ids."""
    text = CODE.sub("", page.read_text())
    headings = [re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in re.findall(r"^#+ (.*)$", text, re.M)]
    return {*headings, *re.findall(r'id="([^"]+)"', text)}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_to_a_heading_lead_to_one(page):
    for link, anchor in re.findall(r"\]\(([^)#:]*)#([^)]+)\)", CODE.sub("", page.read_text())):
        target = page.parent / link if link else page
        assert target.suffix != ".md" or anchor in anchors(target), f"{link}#{anchor}"


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
