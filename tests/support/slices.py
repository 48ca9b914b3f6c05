"""A control group of a test's own: what it starts is measured apart from the machine, and goes before others."""

from __future__ import annotations

import contextlib
import os
import uuid
from pathlib import Path

import psutil
from common import wait_for

ROOT = Path("/sys/fs/cgroup")
V1 = ("cpu", "cpuacct", "memory")


class Slice:
    """Raises OSError where none can be made. `name` is a `cgroup_parent` for containers. `shares`: its weight, where
    that of another group is 1024."""

    def __init__(self, shares: int = 262144) -> None:
        self.name = f"/rorg-test-{uuid.uuid4().hex[:8]}"
        self.v1 = (ROOT / "cpuacct").is_dir()
        for folder in self._folders():
            folder.mkdir(exist_ok=True)
        if self.v1:
            (self._folder("cpu") / "cpu.shares").write_text(str(shares))
        else:
            (ROOT / "cgroup.subtree_control").write_text("+cpu +memory")
            (self._folder() / "cpu.weight").write_text(str(min(10000, max(1, shares * 100 // 1024))))
            (self._folder() / "cgroup.subtree_control").write_text("+cpu +memory")

    def _folder(self, controller: str = "") -> Path:
        return ROOT / controller / self.name[1:]

    def _folders(self) -> list[Path]:
        return [self._folder(c) for c in V1] if self.v1 else [self._folder()]

    def add(self, pid: int) -> None:
        """Takes in a process of this machine that is no container."""
        for folder in self._folders():
            (folder / "others").mkdir(exist_ok=True)
            (folder / "others" / "cgroup.procs").write_text(str(pid))

    def look(self, below: str = "") -> dict[str, float]:
        """What Meter asks of the machine, of this group alone, or of a group below it. Its pressure figures are left
        out."""
        if self.v1:
            cpu = int((self._folder("cpuacct") / below / "cpuacct.usage").read_text()) / 1e9
            memory = _stat(self._folder("memory") / below / "memory.stat", "total_rss")
        else:
            cpu = _stat(self._folder() / below / "cpu.stat", "usage_usec") / 1e6
            memory = _stat(self._folder() / below / "memory.stat", "anon")
        total = psutil.virtual_memory().total
        return {
            "cpu_seconds": cpu,
            "cores": os.cpu_count() or 1,
            "memory": memory,
            "memory_total": total,
            "cpu_some": 0.0,
            "memory_some": 0.0,
        }

    def close(self) -> None:
        """Takes it away, once all that was in it has ended."""
        for controller in sorted({p.name for p in ROOT.iterdir() if p.is_dir()}) if self.v1 else [""]:
            if self._folder(controller).is_dir() and not (ROOT / controller).is_symlink():
                wait_for(lambda c=controller: _gone(self._folder(c)), 10, f"{self.name} to be taken away")


def _gone(folder: Path) -> bool:
    with contextlib.suppress(OSError):
        for below in folder.iterdir():
            if below.is_dir():
                _gone(below)
        folder.rmdir()
    return not folder.exists()


def _stat(file: Path, key: str) -> int:
    return next(int(line.split()[1]) for line in file.read_text().splitlines() if line.split()[0] == key)
