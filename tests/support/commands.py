"""Commands of rorg as somebody types them: each a process of its own, with nobody at its terminal."""

from __future__ import annotations

import functools
import json
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO

from common import TESTS

AT_ITS_BEGIN = ("PYTHON", "LC_", "LANG", "TZ")
"""Variables that Python reads when it begins."""


class Forked:
    """A running `rorg`, as `subprocess.Popen` shows it; begun as a fork of fork_server.py, which takes a tenth of the
    time. Unless said otherwise it has nothing for its standard input, and what it says goes where ours goes."""

    server = "support/fork_server.py"
    """What it is a fork of, in the folder of the tests."""

    def __init__(
        self,
        words: list[str],
        env: Mapping[str, str] | None = None,
        cwd: Path | str | None = None,
        stdin: IO | int = subprocess.DEVNULL,
        stdout: IO | None = None,
        stderr: IO | None = None,
        program: str = "",
    ) -> None:
        """`program`: a script that is run in place of `rorg`'s."""
        environment = dict(os.environ if env is None else env)
        for name in {n for n in {*environment, *os.environ} if n.startswith(AT_ITS_BEGIN)}:
            assert environment.get(name) == os.environ.get(name), f"{name} is read at the begin of Python"
        told = {"words": [str(w) for w in words], "folder": str(cwd or Path.cwd()), "environment": environment}
        told["program"] = program
        sys.audit("subprocess.Popen", "rorg", words, cwd, None)  # a process all the same, for whoever watches for them
        self.returncode: int | None = None
        self._ended, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with other, open(os.devnull) as nothing:
            given = nothing if stdin == subprocess.DEVNULL else stdin
            files = [f.fileno() for f in (other, given, stdout or sys.__stdout__, stderr or sys.__stderr__)]
            socket.send_fds(_server(self.server), [json.dumps(told).encode()], files)
        self.pid = int(self._ended.recv(20))

    def wait(self, timeout: float | None = None) -> int:
        """Its exit code; `timeout` in seconds."""
        if self.returncode is None:
            self._ended.settimeout(timeout)
            try:
                self.returncode = int(self._ended.recv(20))
            except (TimeoutError, BlockingIOError):
                raise subprocess.TimeoutExpired("rorg", timeout or 0.0) from None
            self._ended.close()
        return self.returncode

    def poll(self) -> int | None:
        try:
            return self.wait(0)
        except subprocess.TimeoutExpired:
            return None

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        self.send_signal(15)

    def kill(self) -> None:
        self.send_signal(9)


@functools.cache
def _server(script: str) -> socket.socket:
    """Where processes are begun; it ends with us."""
    ours, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with other:
        subprocess.Popen([sys.executable, str(TESTS / script)], stdin=other)
    return ours


def run(
    words: list[str], env: Mapping[str, str] | None = None, cwd: Path | str | None = None, timeout: float = 90.0
) -> subprocess.CompletedProcess[str]:
    """What it says, however it ends. `timeout` in seconds."""
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        process = Forked(words, env, cwd, stdout=out, stderr=err)
        try:
            code = process.wait(timeout)
        finally:
            process.kill()
        out.seek(0)
        err.seek(0)
        return subprocess.CompletedProcess(words, code, out.read(), err.read())


def rorg(
    *words: str, code: int = 0, cwd: Path | None = None, timeout: float = 90.0, **environment: str
) -> subprocess.CompletedProcess[str]:
    """What it says; fails on another exit code than `code`. `timeout` in seconds."""
    done = run([*words], {**os.environ, **environment}, cwd, timeout)
    assert done.returncode == code, f"exit {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done
