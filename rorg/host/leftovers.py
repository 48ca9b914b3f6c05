"""Processes of a container that its engine knows nothing of: it was killed amid the container's start."""

from __future__ import annotations

import contextlib

import psutil

PATIENCE = 3.0
"""Seconds to end after SIGTERM, before SIGKILL."""


def end_processes(container: str) -> bool:
    """Ends those whose control group is named after a container (its whole id). False where there are none on this
    machine, or they do not end: raises nothing."""
    found = [process for process in psutil.process_iter() if _belongs(process, container)]
    for process in found:
        _signal(process, kill=False)
    _, alive = psutil.wait_procs(found, PATIENCE)
    for process in alive:
        _signal(process, kill=True)
    return bool(found) and not psutil.wait_procs(alive, PATIENCE)[1]


def _belongs(process: psutil.Process, container: str) -> bool:
    try:
        with open(f"/proc/{process.pid}/cgroup", encoding="utf-8", errors="replace") as file:
            return container in file.read()
    except OSError:
        return False


def _signal(process: psutil.Process, kill: bool) -> None:
    with contextlib.suppress(psutil.Error):
        process.kill() if kill else process.terminate()
