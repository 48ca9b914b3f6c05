"""`rorg top` on a pseudo-terminal: what the screen shows, what keys do, and that the terminal is given back."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import pty
import re
import signal
import struct
import subprocess
import sys
import termios
import threading
from pathlib import Path

import commands
import psutil
import pytest
from common import wait_for
from robots import RealRobot

from rorg.cli.top_view import Deed, View, cells_of, fitting, frame, look, pressed

LONG = "a-service-with-a-name-that-is-rather-long"
SERVICES = {
    "arm": {"always_on": True, "driver": {"groups": ["dialout"]}},
    "base": {"always_on": True},
    LONG: {},
}
ESCAPES = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]")


@pytest.fixture
def robot(tmp_path):
    found = RealRobot(tmp_path, "process", None, with_server=True)
    found.declare(
        SERVICES,
        groups={"all": {"services": ["base", LONG]}},
        policies={"policy": {"budget": {"cpu": 1.5, "memory": "2Gi"}}},
    )
    found.wait(lambda: {"arm", "base"} <= found.active())
    found.settle()
    yield found
    found.close()


class Terminal:
    """A pseudo-terminal with `rorg top` as the leader of its session."""

    def __init__(self, robot: RealRobot, columns: int = 100, lines: int = 24) -> None:
        self.main, other = pty.openpty()
        fcntl.ioctl(other, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))
        self.before = termios.tcgetattr(self.main)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "rorg", "top", "--interval", "200ms"],
            stdin=other,
            stdout=other,
            stderr=other,
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
            env={
                **{k: v for k, v in os.environ.items() if k not in ("COLUMNS", "LINES")},
                "RORG_STATE_DIR": str(robot.state.path),
                "TERM": "xterm",
            },
        )
        os.close(other)
        self.said = ""
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        with contextlib.suppress(OSError):
            while data := os.read(self.main, 65536):
                self.said += data.decode(errors="replace")

    def screen(self) -> str:
        """What was drawn last, without colours."""
        frames = self.said.split("\x1b[H")
        return ESCAPES.sub("", frames[-1]).replace("\r", "")

    def shows(self, *texts: str) -> None:
        try:
            wait_for(lambda: all(t in self.screen() for t in texts), 30, str(texts))
        except AssertionError:
            raise AssertionError(f"{texts} are not on the screen:\n{self.screen()}") from None

    def press(self, keys: str) -> None:
        os.write(self.main, keys.encode())

    def given_back(self) -> bool:
        """The modes are as before, the cursor is seen, and the other screen is left."""
        modes = termios.tcgetattr(self.main)[:4] == self.before[:4]
        return modes and all(self.said.rfind(on) > self.said.rfind(off) for on, off in SWITCHES)

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(30)
        os.close(self.main)


SWITCHES = (("\x1b[?1049l", "\x1b[?1049h"), ("\x1b[?25h", "\x1b[?25l"))


@pytest.fixture
def terminal(robot):
    found = Terminal(robot)
    found.shows("arm", "base", LONG)
    yield found
    found.close()


def order(screen: str) -> list[str]:
    return [line.split()[0] for line in screen.splitlines() if line.startswith(("arm", "base", LONG))]


def test_header_sort_filter_and_help(terminal):
    terminal.shows("2 alive", "budget CPU 1.5 cores, memory 2.0Gi", "pressure: none", "SERVICE", "WHY")
    terminal.press("n")
    wait_for(lambda: order(terminal.screen()) == [LONG, "arm", "base"], 30, terminal.screen())
    terminal.press("m")
    wait_for(lambda: order(terminal.screen())[-1:] == [LONG], 30, terminal.screen())
    terminal.press("/bas\r")
    wait_for(lambda: order(terminal.screen()) == ["base"], 30, terminal.screen())
    terminal.shows("filter: bas")
    terminal.press("\x1b")
    terminal.shows("arm")
    terminal.press("?")
    terminal.shows("choose a service", "restart it, after asking")
    terminal.press(" ")
    terminal.shows("2 alive")
    terminal.press("q")
    assert terminal.process.wait(30) == 0
    wait_for(terminal.given_back)


def test_request_and_release(robot, terminal):
    terminal.press(f"/{LONG}\r+")
    terminal.shows(f"request '{LONG}' of developer")
    robot.wait(lambda: LONG in robot.active())
    terminal.press("-")
    terminal.shows(f"Release '{LONG}' of developer", "[y/N]")
    terminal.press("n")
    wait_for(lambda: "[y/N]" not in terminal.screen())
    assert len(robot.client().requests()) == 1
    terminal.press("-")
    terminal.shows("[y/N]")
    terminal.press("y")
    terminal.shows("released:")
    assert robot.client().requests() == []
    terminal.press("-")
    terminal.shows("no request that can be released")


@pytest.mark.slow
def test_a_restart_asks_and_a_driver_asks_twice(robot, terminal):
    run = robot.client().service("arm")["incarnation"]
    terminal.press("/arm\rr")
    terminal.shows("Restart arm? [y/N]")
    terminal.press("y")
    terminal.shows("arm moves hardware", "[y/N]")
    assert robot.client().service("arm")["incarnation"] == run
    terminal.press("y")
    terminal.shows("restart of arm requested")
    wait_for(lambda: robot.client().service("arm")["incarnation"] not in (run, ""))


@pytest.mark.slow
def test_logs_have_the_terminal_until_ctrl_c(terminal):
    terminal.press("/base\rl")
    wait_for(terminal.given_back)
    wait_for(lambda: any(map(_shows_logs, psutil.Process(terminal.process.pid).children())))
    terminal.press("\x03")
    wait_for(lambda: not terminal.given_back())
    terminal.shows("base", "2 alive")
    assert terminal.process.poll() is None


def _shows_logs(process: psutil.Process) -> bool:
    """Whether it is the other command, and far enough to be ended by Ctrl-C as it should."""
    caught = re.search(r"SigCgt:\s*(\w+)", Path(f"/proc/{process.pid}/status").read_text())
    return "logs" in process.cmdline() and bool(int(caught[1], 16) >> (signal.SIGINT - 1) & 1)


@pytest.mark.slow
def test_ctrl_z_gives_the_terminal_back_and_goes_on(terminal):
    terminal.press("\x1a")
    wait_for(lambda: psutil.Process(terminal.process.pid).status() == psutil.STATUS_STOPPED)
    wait_for(terminal.given_back)
    terminal.process.send_signal(signal.SIGCONT)
    wait_for(lambda: not terminal.given_back())
    terminal.shows("2 alive")
    terminal.press("q")
    assert terminal.process.wait(30) == 0
    wait_for(terminal.given_back)


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_signal_gives_the_terminal_back(terminal, number, code):
    terminal.process.send_signal(number)
    assert terminal.process.wait(30) == code
    wait_for(terminal.given_back)


@pytest.mark.slow
def test_it_goes_on_while_rorg_is_gone(robot, terminal):
    robot.stop()
    terminal.shows("cannot")
    terminal.press("q")
    assert terminal.process.wait(30) == 0


def test_sixty_columns_show_whole_names(robot):
    terminal = Terminal(robot, columns=60)
    try:
        terminal.shows(LONG, "CPU", "2 alive")
        assert all(len(line) <= 60 for line in terminal.screen().splitlines())
        assert "WHY" not in terminal.screen()
    finally:
        terminal.close()


@pytest.mark.slow
def test_piped_it_prints_once_with_numbers_as_json(robot):
    def top(*words: str) -> str:
        return commands.rorg("top", *words, RORG_STATE_DIR=str(robot.state.path)).stdout

    assert "2 alive" in top()
    assert set(top("-o", "name").split()) == {"arm", "base"}
    found = json.loads(top("-o", "json"))
    assert {type(found["services"][0][key]) for key in ("cpu", "memory", "priority")} <= {int, float}
    assert found["pressure"]["budget"] == {"cpu": 1.5, "memory": 2 << 30}
    assert found["machine"]["cores"] >= 1


# -- the view by itself ----------------------------------------------------------------------------------------


def row(name: str, cpu: float = 0.0, memory: int = 0) -> dict:
    state = {
        "state": "running",
        "priority": 50,
        "why": "requested by developer (tour)",
        "alive": True,
        "measured": True,
    }
    return {"service": name, "cpu": cpu, "memory": memory, **state}


FOUND = {
    "services": [row(f"s{n:02}", n / 10, n << 20) for n in range(40)],
    "alive": 40,
    "machine": {"cpu": 1.0, "cores": 4, "memory": 1 << 30, "memory_total": 8 << 30, "cpu_some": 3, "memory_some": 0},
    "pressure": {"reason": "memory is short", "measures": ["shed"], "budget": None},
}


@pytest.mark.parametrize("width", [20, 60, 80, 200])
@pytest.mark.parametrize("height", [5, 24, 100])
def test_a_frame_fits_and_shows_what_is_chosen(width, height):
    for selected in ("s00", "s20", "s39"):
        lines = ["".join(text for text, _ in line) for line in frame(View(selected=selected), FOUND, width, height)]
        assert len(lines) <= height
        assert any(line.startswith(selected) for line in lines)


def test_columns_go_in_their_order():
    rows = [cells_of(row("localization"))]
    assert [fitting(rows, width)[-1] for width in (200, 60, 40, 12)] == ["why", "why", "memory", "service"]
    assert all(fitting(rows, width)[0] == "service" for width in range(1, 200))


def test_no_key_does_anything_that_was_not_meant():
    names = ["arm", "base"]
    for key in ("x", "\x01", "enter", "left", "y"):
        assert pressed(View(), key, names) == (View(), None)
    asked, deed = pressed(View(), "r", names)
    assert deed is None
    assert pressed(asked, "y", names)[1] == Deed("restart", "arm")
    for key in ("n", "enter", "escape", "r"):
        assert pressed(asked, key, names)[1] is None
    assert pressed(View(), "l", []) == (View(), None)


def test_what_no_engine_measures_is_alive_all_the_same():
    service = {"state": "running", "effective_priority": 50, "why": "always on", "container": "c", "incarnation": "c@t"}
    machine = {"cpu_seconds": 1.0, "cores": 2, "memory": 1, "memory_total": 2, "cpu_some": 0.0, "memory_some": 0.0}
    usage = [{"at": at, "services": {}, "machine": machine} for at in (0.0, 1.0)]
    stopped = {**service, "state": "exited", "incarnation": ""}
    elsewhere = {**service, "container": ""}
    services = {"web": service, "stopped": stopped, "elsewhere": elsewhere}
    snapshot = look(*usage, {"services": services, "pressure": {}})
    assert snapshot["alive"] == 1
    (row,) = [row for row in snapshot["services"] if row["alive"]]
    assert (row["service"], cells_of(row)["cpu"], cells_of(row)["memory"]) == ("web", "-", "-")
