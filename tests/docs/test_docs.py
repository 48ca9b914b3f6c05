"""Reference pages are what the code says; links lead somewhere."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from common import ROOT

PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md")), ROOT / "manifests" / "README.md"]


@pytest.mark.slow
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


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_no_log_is_written_into_a_tree(page):
    """Each revision there would have uncommitted files beside its commit, and a `+` in the history."""
    assert not re.findall(r"^\$ .*rorg run .*2> ?[\w-]+\.log", page.read_text(), re.M)


def test_the_plus_behind_a_commit_is_explained():
    for page in ("how-to/history.md", "reference/output.md"):
        assert re.search(r"`\+`[^|\n]*uncommitted", (ROOT / "docs" / page).read_text()), page


def test_the_files_that_contributing_names_are_there():
    for name in re.findall(r"`((?:rorg|tests|docs)/[\w/.-]+)`", (ROOT / "CONTRIBUTING.md").read_text()):
        assert (ROOT / name).exists() or "NAME" in name, name


NUMBERS = {"all pass": 0, "three cases fail": 3}
"""What the first contribution says of a run of tests -> how many fail."""


@pytest.mark.slow
def test_the_first_contribution_is_what_contributing_says(tmp_path):
    """Its commands, on a copy: what a newcomer meets first must not be about words that are gone."""
    text = (ROOT / "CONTRIBUTING.md").read_text().partition("## Your first contribution")[2].partition("\n## ")[0]
    lines = [line for block in re.findall(r"```sh\n(.*?)```", text, re.DOTALL) for line in block.splitlines()]
    assert sum(line.startswith("sed ") for line in lines) == 2
    for name in ("rorg", "tests", "clients/python"):
        shutil.copytree(ROOT / name, tmp_path / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(tmp_path / "clients/python")])}
    for line in lines:
        if line.startswith("sed "):
            before = contents(tmp_path)
            subprocess.run(["sh", "-c", line], cwd=tmp_path, check=True)
            assert contents(tmp_path) != before, line
        elif found := re.match(r"make test ARGS=(\S+)", line):
            command = [sys.executable, "-m", "pytest", found[1]]
            done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
            failed = sum(map(int, re.findall(r"(\d+) failed", done.stdout)))
            passed = sum(map(int, re.findall(r"(\d+) passed", done.stdout)))
            expected = next(number for words, number in NUMBERS.items() if words in line)
            assert (failed, passed > 100) == (expected, True), f"{line}\n{done.stdout[-2000:]}{done.stderr[-2000:]}"
            if told := re.search(r"(\d+) cases", line):
                assert abs(passed - int(told[1])) < 20, line


def contents(folder: Path) -> list[bytes]:
    """What the exercise changes."""
    return [
        path.read_bytes() for path in sorted([folder / "rorg/core/gates.py", *folder.glob("tests/cases/planner/*")])
    ]


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
