"""Whether a program can begin at all. A shell would only say 127, once it has tried."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence

from rorg.errors import EngineError

MOST_OF_A_LINE = 256
"""Bytes of the first line of a script, as the kernel reads it."""


def check_program(service: str, folder: str, command: Sequence[str], path: str) -> None:
    """Raises EngineError where its directory or its program is not there, or may not be used."""
    what, program = f"start {service}", command[0] if command else ""
    if not os.path.isdir(folder):
        raise EngineError(what, f"no directory {folder}", "creating it, or another `working_dir`")
    if not os.access(folder, os.X_OK):
        raise EngineError(what, f"rorg may not enter {folder}", f"chmod +x {folder}", "forbidden")
    if "/" not in program:
        found = shutil.which(program, path=path)
        if found is None:
            why = f"no program '{program}' on this machine" if program else "no program is named"
            raise EngineError(what, why, "`rorg build`, or --engine docker", "missing_image")
    else:
        found = os.path.normpath(os.path.join(folder, program))
        if not os.path.isfile(found):
            raise EngineError(what, f"no program {found}", "creating it, or another `command`", "missing_image")
        if not os.access(found, os.X_OK):
            raise EngineError(what, f"{found} may not be executed", f"chmod +x {found}", "forbidden")
    interpreter = _interpreter(found)
    if interpreter.startswith("/") and not os.access(interpreter, os.X_OK):
        raise EngineError(what, f"{found} is a script for {interpreter}, which is not installed", "installing that")


def _interpreter(path: str) -> str:
    """What the first line of a script names; empty for other programs, and for what cannot be read."""
    try:
        with open(path, "rb") as file:
            line = file.readline(MOST_OF_A_LINE)
    except OSError:
        return ""
    words = line[2:].split() if line.startswith(b"#!") else []
    return os.fsdecode(words[0]) if words else ""
