"""rorg ui"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rorg_client import Client

from rorg.cli.options import Robot
from rorg.cli.output import note

Port = Annotated[int, typer.Option(help="The port on 127.0.0.1; 0 for any free one.", min=0, max=65535)]

BOUND = "RORG_UI_BOUND"
"""The variable by which `rorg run --ui` says that the page ends with its standard input."""


def command(
    context: Robot,
    port: Port = 7880,
    read_only: Annotated[bool, typer.Option("--read-only", help="Show everything, and change nothing.")] = False,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Only print the address.")] = False,
) -> None:
    """Show the robot in the browser: what runs, why, what it costs, and what happened.

    The page may do what you may do. Its address has a token that opens it; it serves this computer only. From another
    one: `ssh -L 7880:127.0.0.1:7880 ROBOT`, then open the printed address there.

    Example: rorg ui --read-only
    """
    from rorg.web.server import Page

    address = str(context.serving("show the robot").address)
    page = Page(lambda: Client(address, patience=0.0), port, read_only)
    note(f"the page is at {page.address}")
    if not no_browser:
        threading.Thread(target=webbrowser.open, args=(page.address,), daemon=True).start()
    if os.environ.get(BOUND):
        threading.Thread(target=_end_with_input, daemon=True).start()
    page.run()


def _end_with_input() -> None:
    sys.stdin.read()
    os.kill(os.getpid(), signal.SIGTERM)


@contextmanager
def beside(rorg: Path) -> Iterator[None]:
    """Serve the page of the rorg with this socket in a process of its own, which costs the loop no time. It ends with
    this process, however that ends."""
    environment = {**os.environ, "RORG_SOCKET": str(rorg), BOUND: "1"}
    command = [sys.executable, "-m", "rorg", "ui", "--no-browser"]
    page = subprocess.Popen(command, env=environment, stdin=subprocess.PIPE)
    try:
        yield
    finally:
        page.terminate()
        page.wait()
