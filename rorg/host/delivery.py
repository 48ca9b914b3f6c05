"""One attempt to hand a text to a command or a URL that an operator chose, with one deadline."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path

from rorg.host.bounded_http import PORTS, answer, place_of
from rorg.host.commands import Exceeded, Output, end
from rorg.host.deadline import Deadline
from rorg.regular_file import read_regular

KEPT = ("PATH", "HOME", "USER", "LOGNAME", "LANG", "TZ")
"""Variables of rorg's own environment that commands get. The others may hold secrets."""
MOST = 64 << 10
"""Bytes of a file with a URL or with headers."""
AGAIN = (408, 425, 429)
"""Answers below 500 after which another attempt may succeed."""


class Undelivered(Exception):
    """`why` names no secret: of a URL only the host, of a command no output. `again`: another attempt may succeed."""

    def __init__(self, why: str, again: bool = True) -> None:
        self.why, self.again = why, again
        super().__init__(why)


def run(words: Sequence[str], text: bytes, variables: Mapping[str, str], timeout: float, stop: threading.Event) -> None:
    """Run a command that reads the text from stdin, until it ends or `stop` is set. Raises Undelivered."""
    kept = {name: os.environ[name] for name in KEPT if name in os.environ}
    given = {name: value.replace("\0", "").encode(errors="replace").decode() for name, value in variables.items()}
    source = os.memfd_create("notification")
    try:
        os.write(source, text)
        os.lseek(source, 0, os.SEEK_SET)
        child = subprocess.Popen(
            list(words),
            stdin=source,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            cwd="/",
            env={**kept, **given},
            start_new_session=True,
        )
    except (OSError, ValueError) as error:
        raise Undelivered(f"{words[0]}: {getattr(error, 'strerror', None) or error}", again=False) from error
    finally:
        os.close(source)
    try:
        code = _ended(child, Output(timeout, stop))
    except Exceeded as exceeded:
        end(child, signal.SIGTERM)
        raise Undelivered(f"{words[0]}: {exceeded.why}") from exceeded
    if code:
        raise Undelivered(f"{words[0]} exited with code {code}")


def _ended(child: subprocess.Popen[bytes], output: Output) -> int:
    """The exit code of a command once it has ended. Raises Exceeded."""
    while True:
        with contextlib.suppress(subprocess.TimeoutExpired):
            return child.wait(output.turn())


def post(url: str, text: bytes, headers: Mapping[str, str], timeout: float) -> None:
    """Post a text. Raises Undelivered unless the answer is 2xx."""
    try:
        host, _ = place_of(url, *PORTS)
    except OSError as error:
        raise Undelivered("its URL is not an http:// or https:// URL", again=False) from error
    try:
        with answer(url, Deadline.within(timeout), body=text, headers=headers) as reply:
            status = reply.status
    except OSError as error:
        raise Undelivered(f"{host}: {error.strerror or error}") from error
    if not 200 <= status < 300:
        raise Undelivered(f"{host} answers {status}", again=status >= 500 or status in AGAIN)


def first_line(path: str) -> str:
    """The first line of a file. Raises Undelivered."""
    return next(iter(_lines(path)), "")


def headers_of(path: str) -> dict[str, str]:
    """The headers in a file: lines `NAME: VALUE`; empty lines and comments (#) do not count. Raises Undelivered."""
    headers = {}
    for number, line in enumerate(_lines(path), 1):
        name, colon, value = line.partition(":")
        if line.startswith("#") or not line:
            continue
        if not colon or not name.strip():
            raise Undelivered(f"line {number} of {path} is not NAME: VALUE", again=False)
        headers[name.strip()] = value.strip()
    return headers


def _lines(path: str) -> list[str]:
    try:
        text = read_regular(Path(path), MOST).decode()
    except (OSError, UnicodeDecodeError) as error:
        raise Undelivered(f"{path}: {getattr(error, 'strerror', None) or 'it is not UTF-8'}", again=False) from error
    return [line.strip() for line in text.splitlines()]
