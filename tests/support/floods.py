"""Callers that mean harm to the server: what they send, in threads or, as `python floods.py SOCKET KIND`, in a process
of their own, which goes on until its input ends."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator

from http_message import read_message


def asking(method: str, path: str, body: bytes = b"", **headers: str) -> bytes:
    """A whole request."""
    lines = [f"{method} {path} HTTP/1.1", "host: x", *(f"{k.replace('_', '-')}: {v}" for k, v in headers.items())]
    lines += ["content-type: application/json", f"content-length: {len(body)}"] if body else []
    return "\r\n".join([*lines, "", ""]).encode() + body


NAMES = {"services": [f"unknown-service-{n}" for n in range(299)], "ttl": "10s"}
FLOODS: dict[str, Callable[[int], bytes]] = {
    "reads": lambda n: asking("GET", "/v1/services/camera"),
    "long reads": lambda n: asking("GET", "/v1/services"),
    "changes": lambda n: asking(
        "DELETE" if n % 100 > 50 else "PUT", f"/v1/requests/r{n % 50}", b'{"services": ["camera"], "ttl": "9s"}'
    ),
    "waits": lambda n: asking("GET", "/v1/wait?services=probed&timeout=0"),
    "unknown names": lambda n: asking("PUT", "/v1/requests/x", json.dumps(NAMES).encode()),
    "no HTTP": lambda n: os.urandom(200) + b"\r\n\r\n",
}


def connect(path: str, timeout: float = 10.0) -> socket.socket:
    found = socket.socket(socket.AF_UNIX)
    found.settimeout(timeout)
    found.connect(path)
    return found


def answer(connection: socket.socket) -> bytes:
    """One answer with a length; empty where it is hung up on."""
    found = read_message(connection)
    return b"\r\n\r\n".join(found) if found else b""


@contextlib.contextmanager
def flood(path: str, what: Callable[[int], bytes], threads: int = 8) -> Iterator[list[int]]:
    """Asks `what(number)` without a pause, on so many connections, hung up on or not; gives the statuses of answers."""
    over, statuses = threading.Event(), list[int]()

    def one(number: int) -> None:
        while not over.is_set():
            time.sleep(0.005)
            with contextlib.suppress(OSError), connect(path, 1.0) as connection:
                while not over.is_set():
                    connection.sendall(what(number))
                    status = answer(connection)[9:12]
                    if not status:
                        break
                    statuses.append(int(status))
                    number += threads

    started = [threading.Thread(target=one, args=(number,), daemon=True) for number in range(threads)]
    for thread in started:
        thread.start()
    try:
        yield statuses
    finally:
        over.set()
        for thread in started:
            thread.join(30)


@contextlib.contextmanager
def flooding(path: str, kind: str) -> Iterator[None]:
    """Beside the block, in a process that leaves the processors to others: what it costs is what rorg does for it."""
    command = [sys.executable, __file__, path, kind]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, preexec_fn=lambda: os.nice(19), **pipes) as process:
        try:
            assert process.stdout.readline() == b"begun\n"
            yield
        finally:
            process.stdin.close()


if __name__ == "__main__":
    with flood(sys.argv[1], FLOODS[sys.argv[2]], threads=32) as heard:
        while len(heard) < 40:
            time.sleep(0.01)
        print("begun", flush=True)
        sys.stdin.read()
