"""Runs `rorg` in a process whose CPU time and memory are measured and limited."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

MOST_SECONDS, MOST_MEMORY = 30, 1 << 30
"""Limits that stop a runaway process; a test asserts much less."""


@dataclass(frozen=True)
class Measured:
    """How one command ended. `cpu` in seconds, `memory` in MiB (the peak of resident pages)."""

    code: int
    out: str
    cpu: float
    memory: float


def measured(*words: str | Path, cwd: Path, env: dict[str, str] | None = None) -> Measured:
    """Runs one command to its end, or to its limits. A read that blocks is ended by a deadline on the clock."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (MOST_SECONDS, MOST_SECONDS))
        resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))

    with tempfile.TemporaryFile("w+") as said:
        process = subprocess.Popen(
            [sys.executable, "-m", "rorg", *map(str, words)],
            cwd=cwd,
            env={**os.environ, **(env or {})},
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=subprocess.STDOUT,
            preexec_fn=limit,
        )
        timeout = subprocess.Popen(["sh", "-c", f"sleep 60; kill -9 {process.pid}"], start_new_session=True)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        os.killpg(timeout.pid, 9)
        timeout.wait()
        said.seek(0)
        return Measured(process.returncode, said.read(), used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)
