"""The documentation as a site: every page is there, search finds it, and a link that leads nowhere fails the build."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from common import ROOT


def build(folder, more: str = "") -> subprocess.CompletedProcess[str]:
    program = f"import sys; sys.path.insert(0, 'docs'); from pathlib import Path; from build_site import build; \
sys.exit(build(Path({str(folder)!r}), {more!r}))"
    return subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=300)


@pytest.mark.slow
def test_every_page_is_there_and_found(tmp_path):
    done = build(tmp_path / "site")
    assert (done.returncode, done.stderr) == (0, "")
    pages = {p.stem for p in (ROOT / "docs/how-to").glob("*.md")}
    assert {p.stem for p in (tmp_path / "site/docs/how-to").glob("*.html")} == pages
    index = json.loads((tmp_path / "site/search/search_index.json").read_text())
    found = {entry["location"] for entry in index["docs"] if "Prometheus" in entry["title"]}
    assert "docs/how-to/metrics.html" in found
    assert (tmp_path / "site/docs/terminal.svg").exists()
    assert 'href="../schemas/index.html"' in (tmp_path / "site/docs/index.html").read_text()


@pytest.mark.slow
@pytest.mark.parametrize("link", ["[a](docs/nothing.md)", "[a](docs/tutorial.md#nothing)"])
def test_a_link_that_leads_nowhere_fails_it(tmp_path, link):
    done = build(tmp_path / "site", f"\n{link}\n")
    assert done.returncode == 1
    assert "nothing" in done.stderr
