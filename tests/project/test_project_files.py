"""The files that a newcomer meets first: README, changelog, make help, metadata, CI, hooks, and forms of issues."""

from __future__ import annotations

import re
import runpy
import subprocess
import tomllib
import warnings
from pathlib import Path
from typing import Any

import pytest
import yaml
from common import ROOT
from tools import tool

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
METADATA = PROJECT["project"]
MOST_LINES = {"README.md": 130, "CHANGELOG.md": 80}
MOST_TARGETS = 13
YAML = [ROOT / ".pre-commit-config.yaml", *sorted((ROOT / ".github").rglob("*.yml"))]
FORMS = [ROOT / ".github/ISSUE_TEMPLATE/bug.yml", ROOT / ".github/ISSUE_TEMPLATE/feature.yml"]
MINORS = range(11, 15)


def read(path: Path) -> Any:
    return yaml.safe_load(path.read_text())


@pytest.mark.parametrize("name", MOST_LINES)
def test_a_page_for_everyone_is_short(name):
    assert len((ROOT / name).read_text().splitlines()) <= MOST_LINES[name]


def test_the_picture_of_the_readme_fetches_nothing_and_shows_its_commands():
    commands = runpy.run_path(str(ROOT / "docs/terminal_picture.py"))["COMMANDS"]
    picture = (ROOT / "docs/terminal.svg").read_text()
    assert "docs/terminal.svg" in (ROOT / "README.md").read_text()
    assert not re.search(r"url\(\W*http|@import|href=", picture)
    shown = re.sub(r"<[^>]+>", "", picture).replace("&#160;", " ")
    assert all(command in shown for command in commands), "try `python docs/terminal_picture.py`"


# -- make --------------------------------------------------------------------------------------------------------------


def targets(*files: str) -> set[str]:
    """The targets that a person may call."""
    lines = "\n".join((ROOT / name).read_text() for name in files)
    return {name for names in re.findall(r"^\.PHONY: (.*)$", lines, re.M) for name in names.split()}


def test_make_help_names_all_targets_of_every_day_and_no_more():
    told = subprocess.run(["make", "-s", "help"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    shown = [line.split()[1] for line in told.splitlines()]
    assert len(shown) <= MOST_TARGETS
    assert set(shown) == targets("Makefile")
    assert all(len(line.split()) > 3 for line in told.splitlines()), "each has a comment"


def test_contributing_names_the_long_targets():
    page = (ROOT / "CONTRIBUTING.md").read_text()
    named = {
        words.split()[0] for row in re.findall(r"^\| (`.*?) \|", page, re.M) for words in re.findall("`(.*?)`", row)
    }
    assert named == targets("tests/assurance/targets.mk")


# -- packaging ---------------------------------------------------------------------------------------------------------


def test_the_metadata_are_complete():
    assert METADATA["authors"] == [{"name": "rorg contributors"}]
    assert METADATA["license"] == "Apache-2.0"
    assert METADATA["requires-python"] == ">=3.11"
    assert METADATA["description"]
    assert METADATA["keywords"]
    assert "urls" not in METADATA
    versions = {f"Programming Language :: Python :: 3.{minor}" for minor in MINORS}
    assert versions <= set(METADATA["classifiers"])
    assert not [c for c in METADATA["classifiers"] if c.startswith("License ::")], "the SPDX expression says it"
    assert (ROOT / METADATA["readme"]).exists()


def test_the_changelog_begins_with_this_version():
    text = (ROOT / "CHANGELOG.md").read_text()
    towncrier = PROJECT["tool"]["towncrier"]
    assert towncrier["version"] == METADATA["version"]
    after = text.partition(towncrier["start_string"])[2]
    assert after.lstrip().startswith(f"## {METADATA['version']}")


def test_a_news_fragment_is_short_and_has_a_kind():
    kinds = "|".join(kind["directory"] for kind in PROJECT["tool"]["towncrier"]["type"])
    for path in (ROOT / PROJECT["tool"]["towncrier"]["directory"]).iterdir():
        if path.name != "README.md":
            assert re.fullmatch(rf"\+[a-z0-9-]+\.({kinds})\.md", path.name)
            assert 1 <= len(path.read_text().splitlines()) <= 3, path.name


def test_the_groups_are_those_that_make_and_uv_install():
    groups = PROJECT["dependency-groups"]
    installed = set(re.findall(r"--group (\w+)", (ROOT / "Makefile").read_text()))
    assert installed <= groups.keys()
    assert "dev" in installed, "by which uv and make install the same"


# -- what code hosts and editors read ----------------------------------------------------------------------------------


@pytest.mark.parametrize("path", YAML, ids=lambda path: path.name)
def test_it_is_yaml(path):
    assert isinstance(read(path), dict)


def test_the_workflow_tries_all_pythons_and_runs_everything():
    jobs = read(ROOT / ".github/workflows/ci.yml")["jobs"]
    assert jobs["quick"]["strategy"]["matrix"]["python"] == [f"3.{minor}" for minor in MINORS]
    assert {"run": ".ci/run"} in jobs["everything"]["steps"]
    commands = "\n".join(step.get("run", "") for job in jobs.values() for step in job["steps"])
    for name in re.findall(r"tests/[\w/]+\.py", commands):
        assert (ROOT / name).exists(), name
    for called in re.findall(r"^make (.*)", commands, re.M):
        words = {word for word in called.partition("ARGS=")[0].split() if "=" not in word}
        assert words <= targets("Makefile"), called


def test_of_deprecations_only_those_of_forks_are_ignored():
    said = "This process (pid=7) is multi-threaded, use of {}() may lead to deadlocks in the child."
    with warnings.catch_warnings(record=True) as seen:
        for text in (said.format("fork"), said.format("forkpty"), "something else"):
            warnings.warn(text, DeprecationWarning, stacklevel=1)
    assert [str(warning.message) for warning in seen] == ["something else"]


@pytest.mark.parametrize("path", FORMS, ids=lambda path: path.name)
def test_a_form_asks_with_labels(path):
    form = read(path)
    assert form["name"]
    assert form["description"]
    asked = [field for field in form["body"] if field["type"] != "markdown"]
    assert len({field["id"] for field in asked}) == len(asked)
    assert all(field["attributes"]["label"] for field in asked)
    assert any(field.get("validations", {}).get("required") for field in asked)


def test_each_hook_runs_a_tool_of_the_venv_on_files_that_are_there():
    (local,) = read(ROOT / ".pre-commit-config.yaml")["repos"]
    assert local["repo"] == "local"
    for hook in local["hooks"]:
        tool, *words = hook["entry"].split()
        assert tool.startswith(".venv/bin/")
        assert hook["language"] == "system"
        assert all((ROOT / word).exists() for word in words if word.startswith("tests/"))


def test_ci_installs_each_program_that_tests_run():
    """A test without its program is skipped on a newcomer's machine, and fails in CI."""
    run = {
        name for path in (ROOT / "tests").rglob("*.py") for name in re.findall(r'\btool\("([^"]+)"\)', path.read_text())
    }
    assert {"openssl", "ssh-keygen", "protoc", "g++", "cmake", "chromium"} <= run
    assert run - set(re.findall(r"^need (\S+) ", (ROOT / ".ci/run").read_text(), re.M)) == set()


def test_a_test_without_its_program_is_skipped_and_fails_where_it_is_required(monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    for name in ("CI", "RORG_TEST_REQUIRE_DOCKER"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(pytest.skip.Exception, match="no ssh-keygen here; try `apt install openssh-client`"):
        tool("ssh-keygen")
    monkeypatch.setenv("CI", "true")
    with pytest.raises(pytest.fail.Exception, match="required here: no ssh-keygen"):
        tool("ssh-keygen")
