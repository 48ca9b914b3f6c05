"""Everyday commands are thin clients of the running rorg: what they import, what they ask, what they print."""

from __future__ import annotations

import json
import os
import pty
import re
import subprocess
import sys

import pytest
from robots import write_tree
from thin_commands import GROUPS, SERVICES, heavy, imported, robot, rorg  # noqa: F401

from rorg.cli.commands import COMMANDS, command_of


@pytest.mark.slow
@pytest.mark.parametrize(
    "line",
    [
        "get",
        "get services driving",
        "get driving base --sort-by age",
        "get -l site=lab --group driving -o json",
        "get policies",
        "get groups",
        "get requests -o json",
        "why navigation",
        "request driving --id tour --wait",
        "request driving --id tour --wait --rollback",
        "release tour",
        "run-with driving -- true",
        "hold navigation --for 10m",
        "wait base",
        "restart base --yes --wait",
        "diff",
        "diff -o json",
        "diff -u",
        "apply --yes --wait",
        "events",
        "events --service base --since 1h",
        "history",
        "history show 1",
        "timeline base",
        "logs base",
        "logs base spare -n 5 -t",
    ],
)
def test_a_command_that_the_running_rorg_answers_imports_nothing_heavy(robot, line):  # noqa: F811
    assert heavy(imported(robot, *line.split())) == []


COMMAND_MODULES = {command_of(name).__module__ for name in COMMANDS}


@pytest.mark.parametrize(
    ("line", "environment", "module"),
    [
        ("--help", {}, None),
        ("nosuch", {}, None),
        ("get --help", {}, "rorg.cli.get"),
        ("re", {"_RORG_COMPLETE": "bash"}, None),
        ("release ", {"_RORG_COMPLETE": "bash"}, "rorg.cli.release"),
    ],
)
def test_only_the_command_that_is_called_is_imported(robot, line, environment, module):  # noqa: F811
    found = imported(robot, *line.split(" "), code=2 if line == "nosuch" else 0, **environment)
    own = {module, "rorg.cli.completion"} if environment else {module}  # that answers the shell
    assert COMMAND_MODULES & found - own == set()
    assert module is None or module in found


# -- diff and apply --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_diff_shows_drift_and_changes_at_once(robot):  # noqa: F811
    assert rorg(robot, "diff").stdout == "No differences.\n"
    rorg(robot, "suspend", "--for", "10m")
    robot.drift("pause", "base")
    assert "base" in rorg(robot, "diff", code=1).stdout
    write_tree(robot.tree, {**SERVICES, "more": {}}, groups=GROUPS)
    found = json.loads(rorg(robot, "diff", "-o", "json", code=1).stdout)
    assert ("create", "more") in {(a["verb"], a["service"]) for a in found["actions"]}


def test_diff_and_apply_tell_what_is_wrong_with_the_tree(robot):  # noqa: F811
    (robot.tree / "services/bad.yaml").write_text("x: [\n")
    for words in (("diff",), ("apply", "--yes")):
        said = rorg(robot, *words, code=2).stderr
        assert "bad.yaml:2:1" in said, said
        assert "rorg validate" in said, said


@pytest.mark.slow
def test_diff_of_another_tree_is_computed_here(robot, tmp_path):  # noqa: F811
    other = write_tree(tmp_path / "other", {"camera": {}})
    assert "camera" in rorg(robot, "diff", str(other), code=1).stdout
    assert "owns this robot" in rorg(robot, "apply", str(other), "--yes", code=5).stderr


@pytest.mark.slow
def test_diff_says_the_same_as_without_a_running_rorg(robot):  # noqa: F811
    rorg(robot, "suspend", "--for", "10m")
    rorg(robot, "request", "driving")
    write_tree(robot.tree, {**SERVICES, "base": {"always_on": True, "priority": 7, "command": ["sleep", "999"]}})
    told = rorg(robot, "diff", code=1).stdout
    robot.stop()
    assert rorg(robot, "diff", str(robot.tree), code=1).stdout == told


def test_a_service_may_not_ask_for_differences(robot):  # noqa: F811
    from rorg.client import Forbidden

    write_tree(robot.tree, {**SERVICES, "base": {"always_on": True, "may_request": ["spare"]}}, groups=GROUPS)
    robot.wait(lambda: (robot.state.run / "services/base/rorg.sock").exists())
    with pytest.raises(Forbidden):
        robot.client("base").call("GET", "/v1/diff")


def test_apply_asks_the_person_at_the_terminal(robot):  # noqa: F811
    rorg(robot, "hold", "base", "--for", "10m")
    robot.wait(lambda: "base" not in robot.active())
    for answer, code in ((b"n\n", 5), (b"y\n", 0)):
        main, other = pty.openpty()
        process = subprocess.Popen(
            [sys.executable, "-m", "rorg", "apply", "--timeout", "20"],
            stdin=other,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "RORG_STATE_DIR": str(robot.state.path), "RORG_ENGINE": "process"},
        )
        os.write(main, answer)
        assert process.wait(30) == code
        os.close(main)
        os.close(other)


# -- tables ----------------------------------------------------------------------------------------------------


def test_a_table_on_a_terminal_has_colours_for_states():
    from rorg.cli.output import coloured_table, table

    rows = [
        {"name": "navigation", "state": "running", "health": "Healthy", "why": "requested by developer (tour)"},
        {"name": "arm", "state": "none", "health": "Idle", "why": "-"},
    ]
    columns = ("name", "state", "health", "why")
    ours = coloured_table(rows, columns, 90)
    bare = re.sub(r"\x1b\[[0-9;]*m", "", ours)
    assert [line.rstrip() for line in bare.splitlines()] == table(rows, columns).splitlines()
    for code, word in (("32", "running"), ("32", "Healthy"), ("2", "Idle"), ("1", "STATE")):
        assert f"\x1b[{code}m{word}" in ours


def test_a_narrow_terminal_has_wide_columns_below_and_nothing_is_cut():
    from rorg.cli.output import coloured_table

    rows = [
        {
            "name": "navigation-of-the-long-name",
            "state": "running",
            "why": "requested by developer (tour)",
            "message": "",
        },
        {"name": "arm", "state": "none", "why": "-", "message": "\u753b\u50cf of it is missing"},
    ]
    columns, below = ("name", "state", "why", "message"), ("why", "message")
    assert coloured_table(rows, columns, 40, below, colours=False).splitlines() == [
        "NAME                         STATE",
        "navigation-of-the-long-name  running",
        "    why: requested by developer (tour)",
        "arm                          none",
        "    message: \u753b\u50cf of it is missing",
    ]
    only_why = coloured_table(rows, columns, 70, below, colours=False).splitlines()
    assert only_why[0].split() == ["NAME", "STATE", "WHY"]
    assert "navigation-of-the-long-name" in coloured_table(rows, columns, 5, below)


def test_get_on_a_terminal_needs_no_rich(robot):  # noqa: F811
    main, other = pty.openpty()
    code = "import sys; from rorg.cli.main import run; sys.argv[1:] = ['get']; run(); assert 'rich' not in sys.modules"
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=other,
        env={**os.environ, "RORG_STATE_DIR": str(robot.state.path), "TERM": "xterm", "COLUMNS": "150"},
    )
    assert process.wait(30) == 0
    assert b"\x1b[1mNAME" in os.read(main, 65536)
    os.close(main)
    os.close(other)


def test_what_a_command_computes_itself_needs_no_server(tmp_path):
    """The server's libraries take longer to be loaded than all else that a command does where no rorg runs."""
    tree = write_tree(tmp_path / "tree", {"camera": {}})
    state = {"RORG_STATE_DIR": str(tmp_path / "state"), "RORG_ENGINE": "process"}
    for words, code in ((["diff", str(tree)], 1), (["apply", str(tree), "--yes"], 0)):
        line = [sys.executable, "-X", "importtime", "-m", "rorg", *words]
        done = subprocess.run(line, env={**os.environ, **state}, capture_output=True, text=True)
        assert done.returncode == code, done.stderr[-500:]
        loaded = {entry.rpartition("|")[2].strip() for entry in done.stderr.splitlines()}
        assert "rorg.core.decide" in loaded
        assert loaded & {"fastapi", "starlette", "uvicorn", "docker"} == set()
