"""What a shell offers after TAB, beside a running rorg and without one."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys

import pytest
from common import readable, wait_for
from robots import write_tree
from thin_commands import SERVICES, heavy, imported, robot, rorg  # noqa: F401
from tools import tool

from rorg.cli.app import typer_command
from rorg.cli.commands import COMMANDS
from rorg.cli.completion import answer
from rorg.cli.kinds import KINDS
from rorg.cli.names import declared
from rorg.manifest.policy import Idle

OFFERED = [
    ("why ", {"base", "developer", "driving", "navigation", "roscore", "spare"}),
    ("why n", {"navigation"}),
    ("request d", {"driving"}),
    ("events --kind image", {"image-failed", "image-ready"}),
    ("events --kind crashed,un", {"crashed,unknown-service", "crashed,unplugged"}),
    ("events --kind=unpl", {"--kind=unplugged"}),
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
    ("history ", {"list", "show", "diff", "export"}),
    ("history export --format ", {"jsonl", "protobuf"}),
    ("trace ", {"generate", "record", "show"}),
    ("trace show ", {":files"}),
    ("timeline n", {"navigation"}),
    ("fit n", {"navigation"}),
    ("completion ", {"bash", "zsh", "fish"}),
    ("graph ", {"services", "images"}),
    ("graph images ", {":directories"}),
    ("simulate ", {":files"}),
    ("simulate day.yaml ", {":directories"}),
    ("diff ", {"1", ":directories"}),
    ("why --state-dir ", {":directories"}),
    ("get ", {*(names[0] for names in KINDS.values()), *SERVICES, "developer", "driving"}),
    ("get p", {"policies", "profiles"}),
    ("get groups ", {"driving"}),
    ("explain n", {"navigation", "network"}),
    ("explain spec.upda", {"spec.update", "spec.updates"}),
    ("explain spec.idl", {"spec.idle", *(f"spec.idle.{name}" for name in Idle.model_fields)}),
    ("explain service.", {"service.spec", "service.metadata"}),
    ("explain service.spec.idle.l", {"service.spec.idle.linger"}),
    ("rollback ", {"1"}),
    ("restore --at ", {"1"}),
    ("restore --at=", {"--at=1"}),
    ("diff . ", {"1"}),
    ("history show ", {"1"}),
    ("history diff 1 ", set()),
    ("release ", {"tour"}),
    ("release t", {"tour"}),
]


def offered(robot, shell, line) -> list[str]:  # noqa: F811
    return rorg(robot, *line.split(" "), _RORG_COMPLETE=shell).stdout.splitlines()


@pytest.mark.slow
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
    assert rorg(robot, "why", "--engine", "=", _RORG_COMPLETE="bash").stdout.split() == ["docker", "process", "swarm"]
    assert rorg(robot, "restart", "--wa", _RORG_COMPLETE="bash").stdout == "--wait\n"


@pytest.mark.parametrize("line", ["why nav", "release ", "get -o ", "request --", "get ", "explain spec.", "rollback "])
def test_an_answer_imports_nothing_heavy(robot, line):  # noqa: F811
    assert heavy(imported(robot, *line.split(" "), _RORG_COMPLETE="bash")) == []


def test_names_of_the_kind_that_is_named_before(robot, monkeypatch):  # noqa: F811
    monkeypatch.setenv("RORG_STATE_DIR", str(robot.state.path))
    robot.client().request("navigation", id="tour", ttl=None)
    expected = {
        "requests": {"tour"},
        "request": {"tour"},
        "group": {"driving"},
        "groups": {"driving"},
        "svc": {*SERVICES, "driving", "developer"},
        "images": set(),
    }
    for stop in (lambda: None, robot.stop):
        stop()
        for kind, names in expected.items():
            assert set(answer("fish", ["get", kind, ""]).split("\n")) - {""} == names, kind


def shell_of(robot, folder, name: str) -> dict[str, str]:  # noqa: F811
    """The environment of a shell that has a command rorg, and in `folder` the script that it is given."""
    (folder / "bin").mkdir()
    command = folder / "bin/rorg"
    command.write_text(f'#!/bin/sh\nexec {sys.executable} -m rorg "$@"\n')
    command.chmod(0o755)
    (folder / "script").write_text(rorg(robot, "completion", name).stdout)
    path = f"{folder}/bin:/usr/bin:/bin"
    return {"PATH": path, "RORG_STATE_DIR": str(robot.state.path), "HOME": str(folder), "TERM": "xterm"}


@pytest.mark.slow
def test_bash_itself_completes(robot, tmp_path):  # noqa: F811
    """By the script that it is given, as it does after TAB."""
    environment = shell_of(robot, tmp_path, "bash")
    asked = (
        f"source {tmp_path}/script\n"
        'tab() { COMP_WORDS=(rorg "$@"); COMP_CWORD=$#; _rorg rorg; echo "${COMPREPLY[*]}"; }\n'
        "tab why na; tab request base ''; tab why --engine = p; tab wh"
    )
    done = subprocess.run(
        ["bash", "-c", asked],
        capture_output=True,
        text=True,
        timeout=60,
        env=environment,
    )
    lines = done.stdout.splitlines()
    assert lines[0] == "navigation", done.stderr
    assert set(lines[1].split()) == {"driving", "navigation", "roscore", "spare"}
    assert lines[2:] == ["process", "why"]


@pytest.mark.slow
def test_fish_itself_completes(robot, tmp_path):  # noqa: F811
    (tmp_path / "folder").mkdir()
    asked = ["why na", "request base ", "why --engine=p", "restart --wa", "diff fol", "why 'na"]
    lines = "\n".join(f'complete -C "rorg {line}"; echo "-- $status"' for line in asked)
    done = subprocess.run(
        [tool("fish"), "--no-config", "-c", f"source {tmp_path}/script\n{lines}"],
        capture_output=True,
        text=True,
        timeout=60,
        cwd=tmp_path,
        env=shell_of(robot, tmp_path, "fish"),
    )
    found = [{w.split("\t")[0] for w in part.split("\n")} - {""} for part in done.stdout.split("-- 0\n")]
    assert found == [
        {"navigation"},
        {"driving", "navigation", "roscore", "spare"},
        {"--engine=process"},
        {"--wait"},
        {"folder/"},
        {"navigation"},
        set(),
    ], done.stderr


@pytest.mark.slow
def test_zsh_itself_completes(robot, tmp_path):  # noqa: F811
    """On a terminal: after TAB the line goes on, or shows what may stand there."""
    (tmp_path / "folder").mkdir()
    environment, zsh = shell_of(robot, tmp_path, "zsh"), tool("zsh")
    pid, terminal = pty.fork()
    if pid == 0:
        os.chdir(tmp_path)
        os.execve(zsh, ["zsh", "-f", "-i"], environment)
    seen = ""

    def shows(text: str) -> None:
        def look() -> bool:
            nonlocal seen
            while readable(terminal):
                seen += os.read(terminal, 65536).decode(errors="replace")
            return text in re.sub(r"\x1b\[[0-9;?]*[A-Za-z]|[\r\x07]", "", seen)

        wait_for(look, 30, f"{text!r} in {seen!r}")

    def types(text: str) -> None:
        nonlocal seen
        seen = ""
        os.write(terminal, text.encode())

    try:
        types("PS1='ready> '; autoload -Uz compinit && compinit -D -u; source ./script; echo be''gins\n")
        shows("begins")
        for typed, shown in (
            ("rorg why na\t", "rorg why navigation "),
            ("rorg why --engine=p\t", "rorg why --engine=process"),
            ("rorg restart --wa\t", "rorg restart --wait "),
            ("rorg diff fol\t", "rorg diff folder/"),
            ("rorg comple\t", "rorg completion "),
            ("rorg why --\t", "docker or process"),
        ):
            types(typed)
            shows(shown)
            types("\x15")  # the line is given up
    finally:
        os.close(terminal)
        os.waitpid(pid, 0)


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
    for parameter in typer_command(name).params:
        known = parameter.name in ("service", "services") or {"--engine", "--output", "--state-dir"} & {*parameter.opts}
        chosen = hasattr(parameter.type, "choices") or hasattr(parameter.type, "completes")
        assert chosen or parameter._custom_shell_complete or not known, parameter.name
