"""What a shell offers after TAB, beside a running rorg and without one."""

from __future__ import annotations

import subprocess
import sys
from typing import Annotated

import pytest
from robots import write_tree
from test_thin_commands import SERVICES, heavy, imported, robot, rorg  # noqa: F401

from rorg.cli.commands import COMMANDS, command_of
from rorg.cli.completing import after, answer, declared
from rorg.cli.options import NAMES_OF_KIND, Argument, Option
from rorg.cli.signature import parameters

OFFERED = [
    ("why ", {"base", "developer", "driving", "navigation", "roscore", "spare"}),
    ("why n", {"navigation"}),
    ("request base nav", {"navigation"}),
    ("request base driving b", set()),
    ("hold --for 10m base s", {"spare"}),
    ("hold --reason x --fo", {"--for"}),
    ("why x", set()),
    ("why base s", set()),
    ("restart --w", {"--wait"}),
    ("restart --wait --w", set()),
    ("rele", {"release"}),
    ("nonsense ", set()),
    ("get -o ", {"table", "wide", "name", "yaml", "json"}),
    ("why --engine p", {"process"}),
    ("why --engine=p", {"--engine=process"}),
    ("completion ", {"bash", "zsh", "fish"}),
    ("graph ", {"services", "images"}),
    ("graph images ", {":directories"}),
    ("diff ", {":directories"}),
    ("why --state-dir ", {":directories"}),
    ("release ", {"tour"}),
    ("release t", {"tour"}),
]


def offered(robot, shell, line) -> list[str]:  # noqa: F811
    return rorg(robot, *line.split(" "), _RORG_COMPLETE=shell).stdout.splitlines()


@pytest.mark.parametrize("running", [True, False], ids=["running", "alone"])
def test_what_may_follow(robot, running):  # noqa: F811
    rorg(robot, "request", "navigation", "--id", "tour")
    if not running:
        robot.stop()
    for line, words in OFFERED:
        assert {w.split("\t")[0] for w in offered(robot, "fish", line)} - {""} == words, line
        assert {w.split(":")[0] for w in offered(robot, "zsh", line)} - {""} == {w.split(":")[0] for w in words} - {""}


def test_bash_breaks_words_at_equals_signs(robot):  # noqa: F811
    for words in (["why", "--engine", "=", "p"], ["why", "--engine", "p"]):
        assert rorg(robot, *words, _RORG_COMPLETE="bash").stdout == "process\n"
    assert rorg(robot, "why", "--engine", "=", _RORG_COMPLETE="bash").stdout.split() == ["docker", "process"]
    assert rorg(robot, "restart", "--wa", _RORG_COMPLETE="bash").stdout == "--wait\n"


@pytest.mark.parametrize("line", ["why nav", "release ", "get -o ", "request --"])
def test_an_answer_imports_nothing_heavy(robot, line):  # noqa: F811
    assert heavy(imported(robot, *line.split(" "), _RORG_COMPLETE="bash")) == []


def test_names_of_the_kind_that_is_named_before(robot, monkeypatch):  # noqa: F811
    def command(
        kind: Annotated[str, Argument(help="", completes=("services", "requests"))],
        name: Annotated[str, Argument(help="", completes=NAMES_OF_KIND)],
    ) -> None: ...

    monkeypatch.setenv("RORG_STATE_DIR", str(robot.state.path))
    robot.client().request("navigation", id="tour", ttl=None)
    expected = {
        "requests": {"tour"},
        "request": {"tour"},
        "group": {"driving"},
        "groups": {"driving"},
        "svc": {*SERVICES, "driving", "developer"},
        "nonsense": set(),
        "images": set(),
    }
    for stop in (lambda: None, robot.stop):
        stop()
        for kind, names in expected.items():
            assert set(after(parameters(command), [kind, ""])[1]) == names, kind


def test_bash_itself_completes(robot, tmp_path):  # noqa: F811
    """By the script that it is given, as it does after TAB."""
    (tmp_path / "bin").mkdir()
    command = tmp_path / "bin/rorg"
    command.write_text(f'#!/bin/sh\nexec {sys.executable} -m rorg "$@"\n')
    command.chmod(0o755)
    (tmp_path / "script").write_text(rorg(robot, "completion", "bash").stdout)
    asked = (
        f"PATH={tmp_path}/bin:$PATH; source {tmp_path}/script\n"
        'tab() { COMP_WORDS=(rorg "$@"); COMP_CWORD=$#; _rorg rorg; echo "${COMPREPLY[*]}"; }\n'
        "tab why na; tab request base ''; tab why --engine = p; tab wh"
    )
    done = subprocess.run(
        ["bash", "-c", asked],
        capture_output=True,
        text=True,
        timeout=60,
        env={"PATH": "/usr/bin:/bin", "RORG_STATE_DIR": str(robot.state.path)},
    )
    lines = done.stdout.splitlines()
    assert lines[0] == "navigation", done.stderr
    assert set(lines[1].split()) == {"developer", "driving", "navigation", "roscore", "spare"}
    assert lines[2:] == ["process", "why"]


def test_a_shell_that_nobody_answers_offers_nothing(tmp_path, monkeypatch):
    monkeypatch.setenv("RORG_STATE_DIR", str(tmp_path / "nowhere"))
    monkeypatch.chdir(tmp_path)
    assert answer("bash", ["release", ""]) == ""
    assert answer("bash", []).split() == list(COMMANDS)


def test_names_are_found_in_every_way_of_writing_a_manifest(tmp_path):
    write_tree(tmp_path, {"arm": {}})
    (tmp_path / "one.yaml").write_text("kind: Group\nmetadata: {description: x, name: seeing}\nspec: {}\n")
    (tmp_path / "two.yaml").write_text("kind: Service\nmetadata:\n  description: 'name of'\n  name: 'base'\n")
    (tmp_path / "services/bad.yaml").write_text("x: [\n")
    assert set(declared(tmp_path, ("service", "group"))) == {"arm", "seeing", "base", "developer"}


@pytest.mark.parametrize("name", COMMANDS)
def test_whatever_names_a_service_an_engine_or_a_form_is_completed(name):
    for parameter in parameters(command_of(name)):
        declared = parameter.declared
        words = declared.names if isinstance(declared, Option) else ()
        known = parameter.name in ("service", "services") or {"--engine", "--output", "--state-dir"} & set(words)
        assert declared.completes or not known, parameter.name
        assert isinstance(declared, Argument | Option)
