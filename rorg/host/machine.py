"""Facts about this machine for checks of manifests. Unreadable ones are left out."""

from __future__ import annotations

import contextlib
import difflib
import grp
import os
import stat
from collections.abc import Iterable
from pathlib import Path

import psutil

from rorg.model.machine import ABSENT, DEVICE, DIRECTORY, FILE, SOCKET, Machine, Node

SYSCTLS = (
    "kernel.sched_rt_runtime_us",
    "kernel.pid_max",
    "fs.nr_open",
    "fs.inotify.max_user_watches",
    "fs.inotify.max_user_instances",
)
ENGINES = ("dockerd", "docker-proxy", "podman", "rootlessport", "conmon", "slirp4netns", "pasta")
"""Programs that listen at ports for containers."""
MOST_NAMES = 500
"""Names in a directory that are compared to find a similar one."""


def gather(paths: Iterable[str], root: Path = Path("/")) -> Machine:
    """This machine, with what is at these paths. `root`: contains its files, /dev, /proc and /sys among them."""
    return Machine(
        nodes={path: node(root / path.lstrip("/"), path) for path in sorted(set(paths))},
        ports=ports(),
        sysctls={name: value for name in SYSCTLS if (value := sysctl(name, root)) is not None},
        cgroup=2 if (root / "sys/fs/cgroup/cgroup.controllers").exists() else 1,
        cpus=os.cpu_count() or 1,
        memory=psutil.virtual_memory().total,
        shm=_free(root / "dev/shm"),
    )


def _free(folder: Path) -> int | None:
    """Bytes that can still be written there."""
    try:
        filesystem = os.statvfs(folder)
    except OSError:
        return None
    return filesystem.f_bavail * filesystem.f_frsize


def node(place: Path, path: str) -> Node:
    """The kind of file at a place; links are followed. `path`: its name."""
    try:
        stat_result = os.stat(place)
    except (OSError, ValueError):
        return Node(ABSENT, near=_near(place, path))
    kinds = ((stat.S_ISCHR, DEVICE), (stat.S_ISBLK, DEVICE), (stat.S_ISDIR, DIRECTORY), (stat.S_ISSOCK, SOCKET))
    kind = next((name for test, name in kinds if test(stat_result.st_mode)), FILE)
    group = ""
    with contextlib.suppress(KeyError):
        group = grp.getgrgid(stat_result.st_gid).gr_name
    return Node(kind, stat.S_IMODE(stat_result.st_mode), stat_result.st_uid, stat_result.st_gid, group)


def _near(place: Path, path: str) -> str:
    """Something there with a similar name."""
    try:
        with os.scandir(place.parent) as entries:
            names = [entry.name for entry, _ in zip(entries, range(MOST_NAMES), strict=False)]
    except (OSError, ValueError):
        return ""
    close = difflib.get_close_matches(place.name, names, 1, 0.7)
    return f"{path.rpartition('/')[0]}/{close[0]}" if close else ""


def sysctl(name: str, root: Path = Path("/")) -> int | None:
    """A number of the kernel; None if it has none of that name."""
    try:
        return int((root / "proc/sys" / name.replace(".", "/")).read_text(encoding="ascii").split()[0])
    except (OSError, ValueError, IndexError):
        return None


def ports() -> dict[int, str]:
    """TCP ports of this machine with a listener, and its program if we may know it; without engines."""
    programs: dict[int, str] = {}
    with contextlib.suppress(psutil.Error, OSError):
        for connection in psutil.net_connections("tcp"):
            if connection.status == psutil.CONN_LISTEN and connection.laddr:
                programs[connection.laddr.port] = _program(connection.pid)
    return {port: program for port, program in programs.items() if program not in ENGINES}


def _program(pid: int | None) -> str:
    try:
        return str(psutil.Process(pid).name()) if pid else ""
    except psutil.Error:
        return ""
