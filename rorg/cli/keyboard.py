"""Reads single keys of a terminal, without Enter: rich draws, but reads no keys. The terminal is restored however the
program ends or is suspended."""

from __future__ import annotations

import os
import re
import select
import signal
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

NAMES = {
    **{"\x1b[A": "up", "\x1b[B": "down", "\x1bOA": "up", "\x1bOB": "down"},
    **{"\r": "enter", "\n": "enter", "\x1b": "escape", "\x7f": "backspace", "\b": "backspace"},
}
"""What terminals send for keys without a letter."""
KEY = re.compile(r"\x1b[\[O][AB]|.", re.DOTALL)
ESCAPE = 0.05
"""Seconds within which the rest of a sequence arrives."""
CHUNK = 1024
"""Bytes that are read at a time."""


class Keyboard:
    """Keys of standard input. `leave` and `enter` are called around a stop by Ctrl-Z and around `aside`, to undo and
    redo other changes of the terminal."""

    def __init__(self, enter: Callable[[], None], leave: Callable[[], None]) -> None:
        self._enter, self._leave = enter, leave
        self._file = sys.stdin.fileno()
        self._before: list[Any] = []
        self._keys: list[str] = []

    @contextmanager
    def taken(self) -> Iterator[None]:
        """Takes the terminal for the block, in which SIGTERM and SIGHUP raise SystemExit."""
        self._before, handlers = termios.tcgetattr(self._file), {}
        try:
            for number, handler in ((signal.SIGTERM, _end), (signal.SIGHUP, _end), (signal.SIGTSTP, self._stop)):
                handlers[number] = signal.signal(number, handler)
            self._take()
            yield
        finally:
            try:
                self._give_back()
            finally:
                for number, before in handlers.items():
                    signal.signal(number, before)

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Restores the terminal for another program in the block; Ctrl-C ends only that program."""
        self._give_back()
        before = signal.signal(signal.SIGINT, lambda *_: None)  # not SIG_IGN, which that program would inherit
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)
            self._take()

    def key(self, seconds: float) -> str:
        """The next key: its letter, or up, down, enter, escape, backspace; empty if none comes in time. Raises EOFError
        if the terminal is gone."""
        if not self._keys and self._comes(seconds):
            data = os.read(self._file, CHUNK)
            if not data:
                raise EOFError
            while data.endswith((b"\x1b", b"\x1b[", b"\x1bO")) and self._comes(ESCAPE):
                data += os.read(self._file, CHUNK)
            self._keys = KEY.findall(data.decode(errors="replace"))
        key = self._keys.pop(0) if self._keys else ""
        return NAMES.get(key, key)

    def _comes(self, seconds: float) -> bool:
        return bool(select.select([self._file], [], [], max(0.0, seconds))[0])

    def _take(self) -> None:
        tty.setcbreak(self._file)
        self._enter()

    def _give_back(self) -> None:
        try:
            self._leave()
        finally:
            termios.tcsetattr(self._file, termios.TCSADRAIN, self._before)

    def _stop(self, *_: object) -> None:
        """Handles Ctrl-Z; returns when the program continues."""
        self._give_back()
        os.kill(os.getpid(), signal.SIGSTOP)
        self._take()


def _end(number: int, _: object) -> None:
    sys.exit(128 + number)
