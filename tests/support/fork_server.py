"""Begins `rorg` in processes of their own that need not import everything first: each is a fork of this one, which has.

Its standard input is a socket. A message there is a JSON object of `words`, `folder`, `environment` and `program`,
which is empty or a script in place of `rorg`'s; with four descriptors: who is told, and standard input, output and
error of the process to be. Told is its id, and, when it has ended, its exit code as of `subprocess`. It goes on until
nobody holds the other end."""

from __future__ import annotations

import atexit
import contextlib
import gc
import json
import os
import runpy
import signal
import socket
import sys
import threading
from collections.abc import Callable

import docker  # noqa: F401

from rorg.cli.app import typer_command
from rorg.cli.commands import COMMANDS
from rorg.cli.main import run


def forks(asked: socket.socket) -> bool:
    """Whether this is a process that is to be `rorg`: true in each of them, false at the end in the one they are of."""
    while True:
        told, descriptors, _, _ = socket.recv_fds(asked, 1 << 20, 4)
        if not told:
            return False
        if os.fork() == 0:
            if is_child(descriptors):
                become(json.loads(told), descriptors, asked)
                return True
            os._exit(0)
        for descriptor in descriptors:
            os.close(descriptor)


def is_child(descriptors: list[int]) -> bool:
    """False in a process that has waited for its child, and told its end."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    child = os.fork()
    if child == 0:
        return True
    for descriptor in descriptors[1:]:
        os.close(descriptor)
    with socket.socket(fileno=descriptors[0]) as listener, contextlib.suppress(OSError):
        listener.send(b"%d" % child)
        listener.send(b"%d" % os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
    return False


def become(told: dict, descriptors: list[int], asked: socket.socket) -> None:
    """As if it had been begun like that."""
    asked.detach()
    for number, descriptor in enumerate(descriptors[1:]):
        os.dup2(descriptor, number)
    os.closerange(3, 256)
    os.chdir(told["folder"])
    os.environ.clear()
    os.environ.update(told["environment"])
    sys.argv = [told["program"] or "rorg", *told["words"]]
    signal.signal(signal.SIGINT, signal.default_int_handler)


def ended(run: Callable[[], None]) -> None:
    """Ends this process as Python ends, without the tidying of all that was imported, which would take most of it."""
    code: object = 0
    try:
        run()
    except SystemExit as end:
        code = end.code
    finally:
        threading._shutdown()
        atexit._run_exitfuncs()
        with contextlib.suppress(OSError):
            sys.stdout.flush()
        with contextlib.suppress(OSError):
            sys.stderr.flush()
        os._exit(code if isinstance(code, int) else int(code is not None))


if __name__ == "__main__":
    for name in COMMANDS:
        typer_command(name)
    del sys.path[0]  # tests
    gc.freeze()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    with socket.socket(fileno=os.dup(0)) as asked:
        if forks(asked):
            ended(run if sys.argv[0] == "rorg" else lambda: runpy.run_path(sys.argv[0], run_name="__main__"))
