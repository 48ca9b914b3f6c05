"""What services write is shown on a terminal, and does nothing to it: nobody's reason or output moves the cursor, makes
a line of its own, turns the direction of writing, or colours what is not its own."""

from __future__ import annotations

import json
import os
import pty
import re
import subprocess
import sys
import threading

import commands
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from robots import RealRobot, write_tree

from rorg.cli.output import coloured_table, table
from rorg.cli.terminal import PLAIN, LogText, entry, lines, printable
from rorg.core.plan import Plan, Waiting

NASTY = (
    "x\x1b[2J\x1b]0;title\x07\r\n00:00:00 all is well\x9b31m\u202egnp.exe\u2066 [red]bold[/red] \x7f\x08\u2028\u200b\0"
    "\t\udcff\ufeff\U000e0041"
)
SAYS = "print('\\x1b[31mred\\x1b[0m\\x1b[2J\\x1b]0;title\\x07\\u202eevil\\rover', flush=True)"
OBEYED = re.compile(r"[^\x20-\x7e\n]")
"""Anything but plain text."""
OWN = re.compile(r"\x1b\[[0-9;]*m|\r(?=\n)")
"""What rorg may send to a terminal itself; a terminal's own line ends."""


@given(st.text(st.characters()) | st.text(NASTY))
def test_what_is_printable_is_one_line_that_nothing_obeys(text):
    shown = printable(text)
    assert shown.isprintable()
    assert text == shown or not text.isprintable()
    assert lines(text).replace("\n", "").isprintable()
    head, *rest = entry("12:00 ", text).split("\n")
    assert head.startswith("12:00 ")
    assert all(line.startswith("      | ") for line in rest)


@pytest.mark.parametrize("text", ["größe", "日本語", "a [red] b", "\\n", "🤖", "e\u0301"])
def test_what_people_write_stays_as_it_is(text):
    assert printable(text) == text


@given(st.binary() | st.text(NASTY).map(lambda t: t.encode("utf-8", "replace")), st.integers(1, 7))
def test_a_log_is_the_same_however_it_comes_and_only_its_colours_are_obeyed(content, size):
    log = LogText()
    pieces = [log.text(content[i : i + size]) for i in range(0, len(content), size)] + [log.text(b"", end=True)]
    assert "".join(pieces) == LogText().text(content, end=True)
    left = OWN.sub("", "".join(pieces))
    assert left.replace("\n", "").replace("\t", "").isprintable()


def test_a_log_keeps_its_lines_and_colours():
    assert LogText().text(b"\x1b[31mred\x1b[0m\tb\r\nc\xff\x1b[2Jd", end=True) == (
        "\x1b[31mred\x1b[0m\tb\nc\\xff\\x1b[2Jd" + PLAIN
    )


def test_tables_and_plans_have_a_line_for_each_row():
    rows = [{"why": NASTY}, {"why": "fine"}]
    assert len(table(rows, ("why",)).split("\n")) == 3
    coloured = coloured_table(rows, ("why",), 400)
    assert len(coloured.split("\n")) == 3
    assert "[red]bold[/red]" in coloured
    assert not OBEYED.search(OWN.sub("", coloured))
    plan = Plan((), (Waiting("a", "one\n-   remove  b  two"),))
    assert len(plan.text().splitlines()) == 2


def test_an_error_of_a_manifest_is_one_line(tmp_path):
    tree = write_tree(tmp_path, {"camera": {}})
    (tree / "services/evil.yaml").write_text(f"apiVersion: rorg/v1\nkind: Service\n{json.dumps(NASTY[:40])}: 1\n")
    done = commands.run(["validate", str(tree)])
    assert "all is well" in done.stderr
    assert not OBEYED.search(done.stderr)
    assert not [line for line in done.stderr.splitlines() if line.startswith("00:00:00")]


# -- a robot whose programs try ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    found = RealRobot(tmp_path_factory.mktemp("robot"), "process", None, with_server=True)
    say = ["python3", "-c", f"{SAYS}\nimport time; time.sleep(1000)"]
    found.declare({"evil": {"always_on": True, "may_request": ["camera"], "command": say}, "camera": {}})
    found.wait(lambda: "evil" in found.active())
    reason = NASTY.replace("\udcff", "")
    found.client().hold("camera", 600, reason)
    found.client("evil").request("camera", id="x", reason=reason, ttl=None)
    found.wait(lambda: "all is well" in found.waits("camera"))
    yield found
    found.close()


def on_terminal(robot: RealRobot, *words: str, errors: bool = False) -> str:
    """What a terminal is sent."""
    master, slave = pty.openpty()
    env = {**os.environ, "RORG_STATE_DIR": str(robot.state.path), "TERM": "xterm-256color", "COLUMNS": "300"}
    process = subprocess.Popen([sys.executable, "-m", "rorg", *words], stdout=slave, stderr=slave, stdin=slave, env=env)
    os.close(slave)
    said: list[bytes] = []

    def read() -> None:
        try:
            while chunk := os.read(master, 1 << 16):
                said.append(chunk)
        except OSError:
            return  # the other end is closed

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    assert process.wait(60) == (0 if not errors else process.returncode)
    reader.join(60)
    os.close(master)
    return b"".join(said).decode()


COMMANDS = [
    "why camera",
    "get requests -o wide",
    "get service camera -o wide",
    "events --tail 100",
    "describe camera",
    "diff",
    "top --once",
]


@pytest.mark.parametrize("line", COMMANDS)
def test_a_terminal_obeys_nothing_that_a_service_wrote(robot, line):
    said = on_terminal(robot, *line.split(), errors=True)
    assert "all is well" in said or line.split()[0] in ("describe", "top"), "it is shown"
    assert not OBEYED.search(OWN.sub("", said))
    assert not [text for text in said.splitlines() if text.startswith("00:00:00")]


def test_its_log_is_shown_in_its_colours_and_piped_as_it_is(robot):
    said = on_terminal(robot, "logs", "evil")
    assert "\x1b[31mred\x1b[0m" in said
    assert "\\x1b[2J\\x1b]0;title\\x07\\u202eevil\\rover" in said
    assert not OBEYED.search(OWN.sub("", said))
    raw = subprocess.run(
        [sys.executable, "-m", "rorg", "logs", "evil"],
        env={**os.environ, "RORG_STATE_DIR": str(robot.state.path)},
        capture_output=True,
        check=True,
    )
    assert b"\x1b[2J\x1b]0;title\x07" in raw.stdout


@pytest.mark.parametrize("form", ["json", "yaml"])
def test_programs_read_what_was_written(robot, form):
    read = json.loads if form == "json" else yaml.safe_load
    said = on_terminal(robot, "get", "requests", "-o", form)
    assert not OBEYED.search(OWN.sub("", said))
    assert read(said.replace("\r\n", "\n"))[0]["reason"] == NASTY.replace("\udcff", "")


def test_what_rorg_says_of_them_has_lines_of_its_own_only(robot):
    """`rorg run` writes such lines, after the time."""
    told = [entry("12:00:00 ", line) for line in robot.lines]
    assert any("all is well" in line for line in told)
    assert not OBEYED.search("\n".join(told))
    assert all(re.match(r"12:00:00 |         \| ", line) for text in told for line in text.split("\n"))
