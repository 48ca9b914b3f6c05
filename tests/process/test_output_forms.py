"""Every form of output of every command that lists or does something; and readers that have seen enough."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys

import pytest
import yaml
from command_samples import SAMPLES
from common import ROOT, wait_for
from robots import write_tree
from thin_commands import GROUPS, SERVICES, robot, rorg  # noqa: F401

from rorg.cli.app import typer_command
from rorg.cli.commands import COMMANDS
from rorg.cli.options import FORMS

LINES = {line: shown for sample in SAMPLES.values() for line, shown in sample.forms.items()}
"""Line -> what -o name prints, and some of what -o json says of the first thing."""


def first(found: object) -> object:
    return (found[0] if found else None) if isinstance(found, list) else found


def holds(found: object, expected: object) -> bool:
    return isinstance(found, expected) if isinstance(expected, type) else found == expected


@pytest.mark.slow
@pytest.mark.parametrize("line", LINES)
def test_all_forms(robot, line):  # noqa: F811
    names, keys = LINES[line]
    words = [*line.split(), *([str(robot.tree)] if line in ("validate", "graph") else [])]
    if line == "release tour":
        robot.client().request("navigation", id="tour", ttl=None)
    told = json.loads(rorg(robot, *words, "-o", "json").stdout)
    assert keys is None or {k for k, v in keys.items() if not holds(first(told)[k], v)} == set()
    for form in ("name", "yaml", "wide", "table"):
        if line == "release tour":
            robot.client().request("navigation", id="tour", ttl=None)
        said = rorg(robot, *words, "-o", form).stdout
        if form == "name":
            assert sorted(said.split()) == names
        elif form == "yaml":
            assert type(yaml.safe_load(said)) is type(told)


def test_events_in_all_forms(robot):  # noqa: F811
    numbers = rorg(robot, "events", "-o", "name").stdout.split()
    entries = [json.loads(line) for line in rorg(robot, "events", "-o", "json").stdout.splitlines()]
    assert [str(e["seq"]) for e in entries] == numbers
    assert all(re.search(r"(Z|[+-]\d\d:\d\d)$", e["at"]) for e in entries)
    assert [e["seq"] for e in yaml.safe_load_all(rorg(robot, "events", "-o", "yaml").stdout)] == list(map(int, numbers))
    assert "base" in rorg(robot, "events", "-o", "wide").stdout


@pytest.mark.slow
def test_built_images_in_all_forms(robot):  # noqa: F811
    line = ["build", "--manifests", str(robot.tree)]
    told = json.loads(rorg(robot, *line, "-o", "json").stdout)
    keys = ["id", "image", "log", "message", "outcome", "reference", "seconds", "step"]
    assert [sorted(found) for found in told] == [keys]
    assert rorg(robot, *line, "-o", "name").stdout.split() == [told[0]["image"]]
    assert rorg(robot, *line).stdout == ""


@pytest.mark.slow
def test_mistakes_are_listed_in_all_forms(robot):  # noqa: F811
    write_tree(robot.tree, {**SERVICES, "base": {"nonsense": 1}}, groups=GROUPS)
    told = json.loads(rorg(robot, "validate", str(robot.tree), "-o", "json", code=2).stdout)
    assert isinstance(told[0]["line"], int)
    assert "base.yaml" in rorg(robot, "validate", str(robot.tree), "-o", "name", code=2).stdout
    assert "LINE" in rorg(robot, "validate", str(robot.tree), "-o", "wide", code=2).stdout


@pytest.mark.parametrize("line", ["events -f", "events -ojson", "why base -oyaml", "top -ojson", "graph"])
def test_a_reader_that_has_seen_enough_ends_it_well(robot, line):  # noqa: F811
    read, write = os.pipe()
    process = subprocess.Popen(
        [sys.executable, "-m", "rorg", *line.split()],
        stdout=write,
        stderr=subprocess.PIPE,
        env={**os.environ, "RORG_STATE_DIR": str(robot.state.path)},
    )
    os.close(write)
    if line == "events -f":
        wait_for(lambda: os.read(read, 1))
    os.close(read)
    assert process.wait(60) == 0, process.stderr.read()
    assert process.stderr.read() == b""


TWO = ("logs", "export")
PICTURES = ("plot",)
"""Their `-o` names a file."""


@pytest.mark.parametrize("name", [name for name in COMMANDS if name not in PICTURES])
def test_each_command_with_forms_offers_all_and_is_in_the_reference(name):
    found = [p for p in typer_command(name).params if "-o" in p.opts]
    assert all(set(FORMS) <= set(p.type.choices) for p in found) or name in TWO, "lines and files have two forms"
    assert not found or f"`{name}`" in (ROOT / "docs/reference/output.md").read_text()
