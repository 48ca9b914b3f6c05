"""Draws docs/terminal.svg, the picture at the top of the README: real commands on the robot of `rorg init`, by the
process engine. Where CSS works, the lines appear as they did in the run; elsewhere the picture shows all of them.

Run it after a change of what these commands print: python docs/terminal_picture.py
"""

from __future__ import annotations

import os
import pty
import re
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.text import Text

PICTURE = Path(__file__).with_name("terminal.svg")
COMMANDS = (
    "rorg request navigation --wait",
    "rorg get",
    "rorg why localization",
    "rorg release navigation",
    "rorg get",
)
SECONDS, READING = 20.0, 3.2
"""How long one round of the picture takes, and how long a reader, and so this script, looks at each answer."""
WIDTH = 92
MOVING = "    @media (prefers-reduced-motion: no-preference) {\n"
FONT_FACE = re.compile(r"@font-face \{.*?\}\s*", re.DOTALL)
"""Fonts that rich names by address: a picture must fetch nothing."""


class Answer(NamedTuple):
    """What one command printed, with its colours, and when, in seconds since the first."""

    command: str
    text: str
    asked: float
    printed: float


def answer(command: str, environment: dict[str, str]) -> str:
    """Runs a command whose output is a terminal. Its progress is not shown: standard error is no terminal."""
    ours, its = pty.openpty()
    words = [sys.executable, "-m", "rorg", *shlex.split(command)[1:]]
    process = subprocess.Popen(words, stdout=its, stderr=subprocess.PIPE, env=environment)
    os.close(its)
    parts = []
    while True:
        try:
            part = os.read(ours, 4096)
        except OSError:  # Linux says so once the command has ended
            break
        parts.append(part)
    os.close(ours)
    _, errors = process.communicate()
    if process.returncode:
        sys.exit(f"cannot draw the picture: {command} failed: {errors.decode()}")
    return b"".join(parts).decode().replace("\r\n", "\n")


def record(folder: Path) -> list[Answer]:
    """Runs the commands on a new robot, which is taken down afterwards."""
    robot, state = folder / "robot", folder / "state"
    environment = {
        **os.environ,
        "RORG_ENGINE": "process",
        "RORG_STATE_DIR": str(state),
        "COLUMNS": str(WIDTH),
        "TERM": "xterm-256color",
    }
    environment.pop("NO_COLOR", None)
    rorg = [sys.executable, "-m", "rorg"]
    subprocess.run([*rorg, "init", str(robot)], check=True, env=environment, capture_output=True)
    running = subprocess.Popen([*rorg, "run", str(robot)], env=environment, stderr=subprocess.DEVNULL)
    try:
        subprocess.run([*rorg, "wait", "base"], check=True, env=environment, capture_output=True)
        began, answers = time.monotonic(), []
        for command in COMMANDS:
            asked = time.monotonic() - began
            text = answer(command, environment)
            answers.append(Answer(command, text, asked, time.monotonic() - began))
            time.sleep(READING)
        return answers
    finally:
        subprocess.run([*rorg, "down", "--yes"], env=environment, capture_output=True)
        running.wait(30)


def draw(answers: list[Answer]) -> str:
    """The picture: each command and its answer, with rules that say when each line appears."""
    console = Console(record=True, width=WIDTH, file=open(os.devnull, "w"), force_terminal=True)  # noqa: SIM115
    shown: list[float] = []
    for one in answers:
        console.print(Text.assemble(("$ ", "dim"), (one.command, "bold")))
        lines = one.text.rstrip("\n").split("\n")
        for line in lines:
            console.print(Text.from_ansi(line))
        console.print()
        shown += [one.asked, *(one.printed for _ in range(len(lines) + 1))]
    svg = console.export_svg(title="a robot of three services", unique_id="rorg")
    rules = "".join(appearance(at, shown) for at in sorted({at for at in shown if at > 0.1}))
    return FONT_FACE.sub("", svg).replace("</style>", f"{MOVING}{rules}    }}\n    </style>", 1)


def appearance(at: float, shown: list[float]) -> str:
    """The rule by which the lines that appear at this time are hidden until then, in each round."""
    lines = [number for number, time_ in enumerate(shown) if time_ == at]
    name, percent = f"line-{lines[0]}", 100 * at / SECONDS
    return (
        "    " + ", ".join(f'[clip-path="url(#rorg-line-{number})"]' for number in lines) + " "
        f"{{ animation: {name} {SECONDS:g}s step-end infinite }}\n"
        f"    @keyframes {name} {{ 0% {{ opacity: 0 }} {percent:.1f}% {{ opacity: 1 }} }}\n"
    )


def main() -> None:
    """Records and draws."""
    with tempfile.TemporaryDirectory(prefix="rorg-picture-") as folder:
        PICTURE.write_text(draw(record(Path(folder))), encoding="utf-8")


if __name__ == "__main__":
    main()
