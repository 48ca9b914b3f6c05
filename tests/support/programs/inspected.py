"""Runs `rorg` with the words that follow, and answers questions about its memory: inspected.py SOCKET WORDS...

A question is a line on a connection of its own, the answer is JSON:
  blocks       memory blocks that the interpreter has allocated
  types        number of objects by type, of those that the garbage collector knows
  trim         bytes of the heap before and after the allocator has given back what is free
  trace DEPTH  begins to record where memory is allocated, in so many frames
  sites        bytes by place in the source, since `trace`
"""

import ctypes
import gc
import json
import os
import socket
import sys
import threading
import tracemalloc
from collections import Counter
from collections.abc import Callable

from rorg.cli.main import run
from rorg.daemon.loop import Loop

HERE = "tracemalloc", "inspected"


def blocks() -> int:
    return sys.getallocatedblocks()


def types() -> dict[str, int]:
    """Counted in a copy of the process: an extra reference to a tuple that another thread is still making, as
    `dataclasses.asdict` does, ends that thread with a SystemError."""
    ours, theirs = os.pipe()
    child = os.fork()
    if not child:
        with os.fdopen(theirs, "w") as answer:
            gc.collect()
            json.dump(Counter(f"{type(o).__module__}.{type(o).__qualname__}" for o in gc.get_objects()), answer)
        os._exit(0)
    os.close(theirs)
    with os.fdopen(ours) as answer:
        counts = json.load(answer)
    os.waitpid(child, 0)
    return counts


def heap() -> int:
    """Bytes of anonymous memory."""
    with open("/proc/self/smaps_rollup") as file:
        return next(int(line.split()[1]) << 10 for line in file if line.startswith("Anonymous:"))


def trim() -> list[int]:
    gc.collect()
    before = heap()
    ctypes.CDLL(None).malloc_trim(0)
    return [before, heap()]


def trace(depth: str = "1") -> None:
    tracemalloc.start(int(depth))


def sites() -> list[tuple[str, int, int]]:
    gc.collect()
    found = tracemalloc.take_snapshot().statistics("traceback")
    told = [(" < ".join(f"{f.filename}:{f.lineno}" for f in reversed(s.traceback)), s.size, s.count) for s in found]
    return [site for site in told if not any(word in site[0] for word in HERE)][:4000]


ANSWERS = {question.__name__: question for question in (blocks, types, trim, trace, sites)}


def answer(listener: socket.socket) -> None:
    while True:
        asked, _ = listener.accept()
        with asked, asked.makefile("rw") as lines:
            word, *rest = lines.readline().split()
            json.dump(ANSWERS[word](*rest), lines)


def inspected(run_loop: Callable, listener: socket.socket) -> Callable:
    """The answers begin with the loop: a thread before that would have a heap of its own."""

    def begin(loop: Loop) -> None:
        threading.Thread(target=answer, args=(listener,), name="inspected", daemon=True).start()
        run_loop(loop)

    return begin


if __name__ == "__main__":
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(sys.argv.pop(1))
    listener.listen()
    sys.argv[0] = "rorg"
    Loop.run = inspected(Loop.run, listener)
    run()
