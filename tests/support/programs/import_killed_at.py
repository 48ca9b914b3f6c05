"""`rorg` that kills itself just before the n-th step of writing what it imports or exports, below the working
directory: a directory is made, or a file is opened for writing, renamed or removed. Usage: import_killed_at.py N
COMMAND..."""

from __future__ import annotations

import os
import signal
import sys

from rorg.cli.main import run

left, here = int(sys.argv.pop(1)), os.getcwd()


def hook(event: str, args: tuple) -> None:
    global left
    if event == "open" and not (isinstance(args[2], int) and args[2] & (os.O_WRONLY | os.O_RDWR)):
        return
    known = event in ("open", "os.rename", "os.remove", "os.rmdir", "os.mkdir")
    path = str(args[0]) if known else ""
    if known and here in os.path.abspath(path):
        left -= 1
        if left < 0:
            os.kill(os.getpid(), signal.SIGKILL)


sys.addaudithook(hook)
run()
