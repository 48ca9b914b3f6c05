"""Reads single keys of a terminal, without Enter. The terminal is restored however the program ends or is suspended."""

from __future__ import annotations

import os
import select
import signal
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any

SEQUENCES = {"\x1b[A": "up", "\x1b[B": "down", "\x1bOA": "up", "\x1bOB": "down"}
"""What terminals send for arrow keys."""
ESCAPE = 0.05
"""Seconds within which the rest of a sequence arrives."""
CHUNK = 1024
"""Bytes that are read at a time."""


class Keyboard:
    """Keys of standard input. `leave` and `enter` are called around a stop by Ctrl-Z and around `aside`, to undo and
    redo other changes of the terminal. SIGTERM raises SystemExit."""

    def __init__(self, enter: Callable[[], None], leave: Callable[[], None]) -> None:
        self._enter, self._leave = enter, leave
        self._file = sys.stdin.fileno()
        self._before: list[Any] = []
        self._handlers: dict[int, Any] = {}
        self._keys: list[str] = []

    def __enter__(self) -> Keyboard:
        self._before = termios.tcgetattr(self._file)
        try:
            for number, handler in ((signal.SIGTERM, _end), (signal.SIGHUP, _end), (signal.SIGTSTP, self._stop)):
                self._handlers[number] = signal.signal(number, handler)
            self._take()
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        try:
            self._give_back()
        finally:
            for number, handler in self._handlers.items():
                signal.signal(number, handler)

    def key(self, seconds: float) -> str:
        """The next key: its letter, or up, down, enter, escape, backspace; empty if none comes in time. Raises EOFError
        if the terminal is gone."""
        if not self._keys and self._comes(seconds):
            self._keys = list(self._read())
        return self._keys.pop(0) if self._keys else ""

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

    def _comes(self, seconds: float) -> bool:
        return bool(select.select([self._file], [], [], max(0.0, seconds))[0])

    def _read(self) -> Iterator[str]:
        data = os.read(self._file, CHUNK)
        if not data:
            raise EOFError
        while data[-1:] == b"\x1b" or data[-2:] in (b"\x1b[", b"\x1bO"):
            if not self._comes(ESCAPE):
                break
            data += os.read(self._file, CHUNK)
        text = data.decode(errors="replace")
        while text:
            sequence = next((s for s in SEQUENCES if text.startswith(s)), text[0])
            text = text[len(sequence) :]
            names = {
                **SEQUENCES,
                "\r": "enter",
                "\n": "enter",
                "\x1b": "escape",
                "\x7f": "backspace",
                "\b": "backspace",
            }
            yield names.get(sequence, sequence)

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


def _end(number: int, _: FrameType | None) -> None:
    sys.exit(128 + number)
