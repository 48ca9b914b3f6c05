"""`rorg import` of projects of which something cannot be carried over."""

from __future__ import annotations

import json
import os

import commands
import pytest
from incomplete_projects import UNSUPPORTED, of_units


@pytest.mark.slow
def test_what_cannot_be_carried_over_can_be_left_out(tmp_path):
    (tmp_path / "compose.yaml").write_text(UNSUPPORTED)
    refused = commands.run(["import", "compose"], dict(os.environ), tmp_path)
    assert refused.returncode == 2
    assert "--skip-unsupported" in refused.stderr
    assert not (tmp_path / "manifests").exists()
    done = commands.run(["import", "compose", "--skip-unsupported", "-o", "json"], dict(os.environ), tmp_path)
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["valid"] is True
    skipped = [d["message"] for d in answer["diagnostics"] if d["message"].startswith("skipped: ")]
    assert len(skipped) == refused.stderr.count(": error: ") == 11
    assert {m["name"] for m in answer["manifests"] if m["kind"] == "Service"} == {"nav", "far"}
    assert "skipped: post_start cannot be carried over" in (tmp_path / "manifests/services/nav.yaml").read_text()
    assert commands.run(["validate"], dict(os.environ), tmp_path).returncode == 0


@pytest.mark.slow
def test_an_import_that_does_not_validate_says_what_is_left_to_do(tmp_path):
    (tmp_path / "compose.yaml").write_text("services:\n  nav: {image: 'lab/nav:${TAG}'}\n")
    done = commands.run(["import", "compose"], dict(os.environ), tmp_path)
    assert done.returncode == 2
    assert "manifests/services/nav.yaml:" in done.stderr
    assert "'lab/nav:' is not an image reference" in done.stderr
    assert "the files are written; correct them, then `rorg validate manifests`" in done.stderr
    (tmp_path / "compose.yaml").write_text("services:\n  nav: {image: 'lab/nav:1'}\n")
    done = commands.run(["import", "compose", "--force"], dict(os.environ), tmp_path)
    assert done.returncode == 0
    assert "\nvalid" in done.stderr


def test_units_that_cannot_be_carried_over_can_be_left_out(tmp_path):
    units = {"old": "[Service]\nType=forking\nExecStart=/x\n", "new": "[Service]\nExecStart=/x\n"}
    assert of_units(**units).errors
    found = of_units(skip=True, **units)
    assert [made.name for made in found.manifests] == ["new"]
    assert [d.severity for d in found.diagnostics] == ["warning"]
    for name, text in units.items():
        (tmp_path / f"{name}@.service").write_text(text)
    done = commands.run(["import", "systemd", "new@a.service"], dict(os.environ), tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "manifests/services/new-a.yaml").exists()
