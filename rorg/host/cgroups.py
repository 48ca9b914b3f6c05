"""A container's processes by its cgroup, v1 and v2: what they use, and ending those that are left. The engine's own
figures take 1-2 s for each container."""

from __future__ import annotations

import contextlib
from pathlib import Path

import psutil

ROOT = Path("/sys/fs/cgroup")
PATIENCE = 3.0
"""Seconds to end after SIGTERM, before SIGKILL."""


def container_usage(pid: int) -> tuple[float, int] | None:
    """(CPU seconds since it began, bytes of memory without page cache) of the cgroup of a process; None if it is gone.
    A process that is just ending is in the root already, whose figures are those of the machine."""
    try:
        paths = _paths(pid)
        v1 = "memory" in paths and "cpuacct" in paths
        if "/" in ((paths["memory"], paths["cpuacct"]) if v1 else (paths[""],)):
            return None
        return _v1(paths) if v1 else _v2(paths[""])
    except (OSError, KeyError, ValueError):
        return None


def _paths(pid: int) -> dict[str, str]:
    """Controller -> path of the process's cgroup; the controller of version 2 is called ""."""
    lines = Path(f"/proc/{pid}/cgroup").read_text().splitlines()
    return {c: path for line in lines for _, cs, path in [line.split(":", 2)] for c in cs.split(",")}


def has_swap() -> bool:
    """Whether memory could be swapped out."""
    return len(Path("/proc/swaps").read_text().splitlines()) > 1


def reclaim(pid: int) -> int:
    """Ask the kernel to push the memory of a process's cgroup out to swap, and return the number of bytes. A lower
    limit would do that too, but without room in swap it would invite the OOM killer."""
    before = container_usage(pid)
    if before is None or not has_swap():
        return 0
    paths = _paths(pid)
    if "memory" in paths:
        (ROOT / "memory" / paths["memory"].lstrip("/") / "memory.force_empty").write_text("0")
    else:
        with contextlib.suppress(OSError):  # EAGAIN: less could be freed than was asked for
            (ROOT / paths[""].lstrip("/") / "memory.reclaim").write_text(str(before[1]))
    after = container_usage(pid)
    return max(0, before[1] - after[1]) if after else 0


def _v1(paths: dict[str, str]) -> tuple[float, int]:
    cpu = int((ROOT / "cpuacct" / paths["cpuacct"].lstrip("/") / "cpuacct.usage").read_text()) / 1e9
    return cpu, _stat(ROOT / "memory" / paths["memory"].lstrip("/") / "memory.stat", "total_rss")


def _v2(path: str) -> tuple[float, int]:
    folder = ROOT / path.lstrip("/")
    return _stat(folder / "cpu.stat", "usage_usec") / 1e6, _stat(folder / "memory.stat", "anon")


def _stat(file: Path, key: str) -> int:
    return next(int(line.split()[1]) for line in file.read_text().splitlines() if line.split()[0] == key)


def end_processes(container: str) -> bool:
    """End processes of a container (its whole id) that its engine does not know, because it was killed during a start.
    They are found by the name of their cgroup. False if there are none on this machine, or if they do not end."""
    processes = [process for process in psutil.process_iter() if belongs(process.pid, container)]
    for process in processes:
        _signal(process, kill=False)
    _, alive = psutil.wait_procs(processes, PATIENCE)
    for process in alive:
        _signal(process, kill=True)
    return bool(processes) and not psutil.wait_procs(alive, PATIENCE)[1]


def belongs(pid: int, container: str) -> bool:
    """Return whether a process is in the cgroup of a container (its whole id)."""
    try:
        with open(f"/proc/{pid}/cgroup", encoding="utf-8", errors="replace") as file:
            return container in file.read()
    except OSError:
        return False


def _signal(process: psutil.Process, kill: bool) -> None:
    with contextlib.suppress(psutil.Error):
        process.kill() if kill else process.terminate()
