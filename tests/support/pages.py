"""Pages whose commands are run as they stand there: what a reader types, what that has to say, the files it writes.

A block `console` has commands after `$ `, and below each the lines that its output must hold. Of another language, one
in whose first two lines a comment is nothing but a path, such as `# services/arm.yaml`, is that file.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

SAID = "-- said by: "
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.DOTALL | re.MULTILINE)
PATH = re.compile(r"(?:#!.*\n)?# ([\w./-]+/[\w.-]+)\n")
AGE = re.compile(r"\b\d+s\b")
BEGUN = "timeout 60 sh -c 'until [ -S {socket} ]; do sleep 0.1; done'"
"""A person takes longer than that to go on after `rorg run &`."""


class Step(NamedTuple):
    """One command, or one file."""

    command: str
    expected: list[str]


def steps(page: Path, headings: tuple[str, ...] = ()) -> list[Step]:
    """All that a page does, in its order; or only what stands under these headings."""
    found: list[Step] = []
    sections = re.split(r"^## ", page.read_text(), flags=re.MULTILINE)
    said = "".join(s for s in sections if not headings or s.partition("\n")[0] in headings)
    for language, text in BLOCK.findall(said):
        path = PATH.match(text)
        if path and language != "console":
            found.append(Step(_written(path[1], text), []))
        for line in text.splitlines() if language == "console" else ():
            if line.startswith("$ "):
                found.append(Step(line[2:], []))
            else:
                found[-1].expected.append(line)
    return found


def _written(path: str, text: str) -> str:
    return f"mkdir -p {Path(path).parent} && printf %s {shlex.quote(text)} >{path}"


def script(steps: list[Step], socket: str = "") -> str:
    """What a shell does of it, each step after a line with its number. `socket`: of the rorg that is begun; without
    it nothing waits for that rorg, as in a shell where all is pasted at once."""
    begun = BEGUN.format(socket=socket) if socket else ":"
    return "\n".join(
        f"{step.command}\n{begun}" if step.command.endswith("&") else f"echo '{SAID}{number}'\n{step.command}"
        for number, step in enumerate(steps)
    )


def parts(said: str) -> dict[str, str]:
    """What was said after each such line, by its number or name."""
    return dict(re.findall(rf"^{SAID}(\w+)\n(.*?)(?=^{SAID}|\Z)", said, re.DOTALL | re.MULTILINE))


def is_in(expected: str, told: str) -> bool:
    """Whether these words stand there one after the other, however they are spaced and whatever stands beside them.
    Any age is as good as another."""
    one, other = (" ".join(AGE.sub("1s", text).split()) for text in (expected, told))
    return one in other


def check(steps: list[Step], told: dict[str, str], said: str) -> None:
    """Each step said what the page has below it; `said` is everything."""
    for number, (command, expected) in enumerate(steps):
        answer = told.get(str(number), "")
        for line in expected:
            assert is_in(line, answer), f"$ {command}\n{answer}\nnot in it: {line}\n{said[-3000:]}"


def run(steps: list[Step], prepare: str, folder: Path, *, pasted: bool = False, **env: str) -> None:
    """Runs all of a page in a shell of its own with a home in this folder, after `prepare`, and checks what is said.
    `pasted`: as one block, so nothing waits for the rorg that is begun."""
    home = folder / "home"
    home.mkdir()
    socket = "" if pasted else str(folder / "state/run/rorg.sock")
    (folder / "script").write_text(prepare + script(steps, socket))
    own = {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "HOME": str(home)}
    done = subprocess.run(
        ["bash", folder / "script"],
        cwd=home,
        env={**own, "RORG_STATE_DIR": str(folder / "state"), **env},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
        timeout=200,
    )
    told = parts(done.stdout)
    assert len(steps) > 10
    assert str(len(steps) - 1) in told, done.stdout[-3000:]
    check(steps, told, done.stdout)
