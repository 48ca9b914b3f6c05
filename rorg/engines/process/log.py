"""The output of programs of the process engine: one file each, which is read while it grows, and trimmed.

A program keeps the descriptor that it started with, so its file can neither be renamed nor emptied without losing lines
that are being written. Instead the oldest part is given back to the disk (a hole): offsets in the file stay valid, and
readers go on undisturbed.
"""

from __future__ import annotations

import ctypes
import io
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from rorg.engines.log_lines import LogLine, Reading
from rorg.model.units import nano_stamp

KEPT = 10 << 20
"""Bytes of each log that are kept at least."""
SLACK = 2 << 20
"""Bytes beyond these at which the oldest are given back."""
BLOCK = 1 << 16
"""A multiple of this is given back: it is a multiple of the block size of all common file systems."""
FOUND = 0.1
"""Seconds between two checks for new output."""
PIECE = 1 << 16
"""Bytes that are searched at a time."""
_PUNCH_HOLE, _KEEP_SIZE = 2, 1
_libc = ctypes.CDLL(None, use_errno=True)
_fallocate = getattr(_libc, "fallocate64", None) or _libc.fallocate
_fallocate.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.c_int64, ctypes.c_int64)


def trim_log(path: Path) -> None:
    """Give back what is older than the last KEPT bytes. If the file system cannot do that, empty the file: a robot can
    run without its lines, but not with a full disk."""
    try:
        if path.stat().st_blocks * 512 <= KEPT + SLACK:
            return
        with path.open("r+b") as file:
            upto = (file.seek(0, os.SEEK_END) - KEPT) // BLOCK * BLOCK
            if upto > 0 and _fallocate(file.fileno(), _PUNCH_HOLE | _KEEP_SIZE, 0, upto) != 0:
                file.truncate(0)
    except OSError:
        return  # it is gone


def read_log_from(path: Path, place: int) -> Iterator[tuple[bytes, int]]:
    """Everything from a place on that is still kept, in pieces of whole lines, each with the place after it. A line of
    more than PIECE bytes comes in several. An unfinished line comes too, and again the next time."""
    descriptor = _open(path)
    try:
        while True:
            size = os.fstat(descriptor).st_size
            text, begin = _read(descriptor, place, PIECE)
            lines, over = text.rfind(b"\n") + 1, not text or begin + len(text) >= size
            place = begin + (lines if lines or over else len(text))
            yield (text if over else text[: lines or None]), place
            if over:
                return
    finally:
        os.close(descriptor)


def read_lines(path: Path, tail: int | None, whole: bool) -> Iterator[LogLine]:
    """The last `tail` lines of what is there now, and where the log ends. Later lines are left out: otherwise a program
    that prints faster than it is read would have no last line."""
    descriptor = _open(path)
    try:
        end = os.fstat(descriptor).st_size
        place = 0 if tail is None else _tail(descriptor, end, tail)
        for text, after in _lines(descriptor, place, whole, end):
            place = after
            yield LogLine("", text, str(place))
        yield LogLine("", b"", str(place))
    finally:
        os.close(descriptor)


def follow_lines(path: Path, place: int, over: Callable[[], bool], reading: Reading) -> Iterator[LogLine]:
    """Lines from a place on, each with the time at which it was found, until the run is `over` and everything is read.
    An open file is read to its end even after its folder is removed."""
    descriptor = _open(path)
    try:
        while not reading.is_set():
            last = over()
            for text, after in _lines(descriptor, place, not last):
                place = after
                yield LogLine(nano_stamp(time.time_ns()), text, str(place))
            if last or reading.wait(FOUND):
                return
    finally:
        os.close(descriptor)


def _lines(descriptor: int, place: int, whole: bool, end: int | None = None) -> Iterator[tuple[bytes, int]]:
    """Lines from a place on with the place after each, up to `end` or the end of the file; long ones in pieces.
    `whole`: without an unfinished one."""
    while True:
        size = os.fstat(descriptor).st_size if end is None else end
        text, place = _read(descriptor, place, PIECE)
        text = text if end is None else text[: max(0, end - place)]
        over, cut = not text or place + len(text) >= size, text.rfind(b"\n") + 1
        if not (whole and over) and (over or not cut):
            cut = len(text)
        for line in io.BytesIO(text[:cut]):
            place += len(line)
            yield line, place
        if over:
            return


def _open(path: Path) -> int:
    return os.open(path if path.is_file() else os.devnull, os.O_RDONLY | os.O_CLOEXEC)


def _tail(descriptor: int, end: int, lines: int) -> int:
    """The place where the last `count` lines before `end` begin, or the oldest line that is kept."""
    kept, place = _kept_from(descriptor, 0), end
    wanted = lines + (end > 0 and os.pread(descriptor, 1, end - 1) == b"\n")
    while wanted and place > kept:
        begin = max(kept, place - BLOCK)
        text = os.pread(descriptor, place - begin, begin)
        while wanted and (at := text.rfind(b"\n")) >= 0:
            text, wanted = text[:at], wanted - 1
            place = begin + at + 1
        if wanted:
            place = begin
    return place


def _read(descriptor: int, place: int, most: int) -> tuple[bytes, int]:
    """The text kept from a place on, and where it begins: there, or at the first whole line after what was given
    back."""
    begin = _kept_from(descriptor, place)
    text = os.pread(descriptor, most, begin)
    if _kept_from(descriptor, begin) != begin:  # given back while it was read
        return _read(descriptor, begin, most)
    cut = text.find(b"\n") + 1 if begin > place else 0
    return text[cut:], begin + cut


def _kept_from(descriptor: int, place: int) -> int:
    size = os.fstat(descriptor).st_size
    if place > size:
        return 0  # it was emptied
    try:
        return os.lseek(descriptor, place, os.SEEK_DATA)
    except OSError:
        return size  # there is nothing more
