"""As fork_server.py, with the API's application made beforehand, which would take most of rorg's start."""

from __future__ import annotations

import gc
import os
import runpy
import signal
import socket
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[2] / "support"))

import fork_server
from proof import effects, engine_link  # noqa: F401

import rorg.api.server
from rorg.api.app import make_app
from rorg.cli.app import typer_command
from rorg.cli.commands import COMMANDS


class Later:
    """The operations of the rorg that a fork becomes."""

    target: Any = None

    def __getattr__(self, name: str) -> Any:
        return getattr(Later.target, name)


def prepare() -> None:
    """Make the application once, for the operations that come later."""
    app = make_app(Later())  # type: ignore[arg-type]

    def made(operations: object) -> object:
        Later.target = app.state.operations = operations
        return app

    rorg.api.server.make_app = made  # type: ignore[assignment]


if __name__ == "__main__":
    for name in COMMANDS:
        typer_command(name)
    prepare()
    del sys.path[:2]  # tests
    gc.freeze()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    with socket.socket(fileno=os.dup(0)) as asked:
        if fork_server.forks(asked):
            fork_server.ended(lambda: runpy.run_path(sys.argv[0], run_name="__main__"))
