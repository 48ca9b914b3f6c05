"""Runs `rorg` in a process whose CPU time and memory are measured and limited."""

from __future__ import annotations

import json
import os
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


# The kernel counts what a process had before exec into its peak. So a small process starts the command, not a large
# session of tests.
STARTER = """
import json, os, resource, signal, sys
told, seconds, memory, *words = sys.argv[1:]
pid = os.fork()
if not pid:
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds)))
    resource.setrlimit(resource.RLIMIT_AS, (int(memory), int(memory)))
    os.execv(sys.executable, [sys.executable, "-m", "rorg", *words])
signal.signal(signal.SIGALRM, lambda *_: os.kill(pid, signal.SIGKILL))
signal.alarm(60)
_, status, used = os.wait4(pid, 0)
found = os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime, used.ru_maxrss / 1024
open(told, "w").write(json.dumps(found))
"""


def measured(*words: str | Path, cwd: Path, env: dict[str, str] | None = None) -> Measured:
    """Runs one command to its end, or to its limits. A read that blocks is ended by a deadline on the clock."""
    with tempfile.NamedTemporaryFile("r") as told:
        limits = [told.name, str(MOST_SECONDS), str(MOST_MEMORY)]
        ended = subprocess.run(
            [sys.executable, "-S", "-c", STARTER, *limits, *map(str, words)],
            cwd=cwd,
            env={**os.environ, **(env or {})},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        code, cpu, memory = json.load(told)
    return Measured(code, ended.stdout, cpu, memory)
