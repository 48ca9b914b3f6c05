"""rorg run-with"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Annotated, Any

import typer
from rorg_client import Error as ClientError

from rorg.cli.kinds import Seconds
from rorg.cli.operations import watched
from rorg.cli.options import Robot, ServiceNames, Timeout
from rorg.cli.output import note
from rorg.errors import Invalid

FORWARDED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
TYPED = (signal.SIGINT, signal.SIGQUIT)
"""What a terminal sends to all programs in its foreground, including the command."""


def command(
    context: Robot,
    services: ServiceNames,
    program: Annotated[list[str], typer.Argument(help="A program and its arguments, after `--`.")],
    *,
    no_wait: Annotated[bool, typer.Option("--no-wait", help="Start the command immediately, without waiting.")] = False,
    timeout: Timeout = Seconds(60),
    requester: Annotated[str, typer.Option("--as", help="The service that asks.")] = "developer",
    reason: Annotated[str, typer.Option(help="Why; shown by `rorg why`. Default: the program's name.")] = "",
    priority: Annotated[int | None, typer.Option(help="As in `rorg request`.", min=0, max=100)] = None,
) -> None:
    """Request services for as long as a command runs.

    The command starts when the services and everything they need are ready. The exit code is the command's own, or
    128 plus the number of the signal that ended it. The request ends with this program, however that ends.

    Example: rorg run-with navigation -- rosbag record /tf
    """
    client = context.serving(f"run with {', '.join(services)}")
    if shutil.which(program[0]) is None:
        raise Invalid(f"run {program[0]}", "no such program", "its path")
    reason = reason or f"runs {os.path.basename(program[0])}"
    with _ending():
        request = client.request(*services, reason=reason, priority=priority, requester=requester)
        try:
            if not no_wait:
                with watched(client, services):
                    request.wait(timeout)
            code = _run(program)
        except BaseException:
            request.give_up()
            raise
        try:
            request.release()
        except ClientError as error:
            note(f"request '{request.id}' ends with its lease, since it cannot be released now: {error}")
    sys.exit(code)


@contextmanager
def _ending() -> Iterator[None]:
    """Makes signals raise SystemExit outside of the command, so that nothing is left behind."""

    def end(number: int, _: object) -> None:
        sys.exit(128 + number)

    before = {n: signal.signal(n, end) for n in FORWARDED if n != signal.SIGINT}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _run(program: Sequence[str]) -> int:
    """Runs the command, forwards signals to it, and returns its exit code as a shell does."""
    process: subprocess.Popen[bytes] | None = None
    early: list[int] = []

    def forward(number: int, _: Any) -> None:
        if process is None:
            early.append(number)
        elif number not in TYPED or not _in_the_foreground():
            process.send_signal(number)

    before = {number: signal.signal(number, forward) for number in FORWARDED}
    try:
        process = _begun(program)
        for number in early:
            process.send_signal(number)
        code = process.wait()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return 128 - code if code < 0 else code


def _begun(program: Sequence[str]) -> subprocess.Popen[bytes]:
    try:
        return subprocess.Popen(program)
    except OSError as error:
        raise Invalid(f"run {program[0]}", error.strerror or str(error)) from error


def _in_the_foreground() -> bool:
    """Whether the terminal itself sends typed signals to the command."""
    try:
        terminal = os.open("/dev/tty", os.O_RDONLY | os.O_NOCTTY)
    except OSError:
        return False
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:
        return False
    finally:
        os.close(terminal)
