"""Commands of rorg as somebody types them: each a process of its own, with nobody at its terminal."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def rorg(
    *words: str, code: int = 0, cwd: Path | None = None, timeout: float = 90.0, **environment: str
) -> subprocess.CompletedProcess[str]:
    """What it says; fails on another exit code than `code`. `timeout` in seconds."""
    done = subprocess.run(
        [sys.executable, "-m", "rorg", *words],
        capture_output=True,
        text=True,
        timeout=timeout,
        stdin=subprocess.DEVNULL,
        cwd=cwd,
        env={**os.environ, **environment},
    )
    assert done.returncode == code, f"exit {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done
