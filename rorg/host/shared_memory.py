"""Finds and removes files of shared memory that no process uses."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Callable, Collection, Container, Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

SHM = Path("/dev/shm")
ASIDE = ".rorg-"
"""Prefix of a file that is about to be removed."""
ALL_PROCESSES = 0xEFFFFFFC
"""Inode of the first namespace of process ids (PROC_PID_INIT_INO of the kernel), in which all processes are visible."""
INIT = "1"
"""A process that is no participant, and on some machines hides its mappings even from root."""
LOCKS = ("_el", "_sl")

Identity = tuple[int, int]
"""Device and inode."""
Look = Callable[[Collection[Path]], set[Path]]


class Removed(NamedTuple):
    """The removed files."""

    files: int = 0
    size: int = 0
    """Bytes."""


def in_use(files: Collection[Path]) -> set[Path]:
    """Those that any process of this machine has open, mapped or locked. Raises PermissionError if that cannot be seen:
    without root's rights, or inside a container with its own processes."""
    if os.geteuid() != 0 or os.stat("/proc/self/ns/pid").st_ino != ALL_PROCESSES:
        raise PermissionError("the files of all processes cannot be seen")
    names = {path.name for path in files}
    used: set[Identity | None] = set()
    for pid in (pid for pid in os.listdir("/proc") if pid.isdecimal() and pid != INIT):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # it has ended
            used.update(_mapped(pid))
            used.update(_open(pid, names))
    return {path for path in files if _identity(path) in used or _locked(path)}


def remove_unused(folder: Path, group_of: Callable[[str], str], before: float, look: Look = in_use) -> Removed:
    """Remove groups of files of which none is in use and none is younger than `before` (seconds since the epoch).
    `group_of` returns an empty text for a file that must stay. Raises OSError, and removes nothing, if it cannot be
    seen what is in use."""
    groups = {name: files for name, files in _groups(folder, group_of).items() if _older(files, before)}
    idle = _unused(groups, look)
    # Nobody can open them under their new names. A process that did so since the first look is found by the second.
    aside: list[Path] = []
    unused: list[Path] = []
    try:
        for path in (path for files in idle.values() for path in files):
            aside.append(_set_aside(path))
        renamed = {name: [path for path in aside if group_of(_name(path)) == name] for name in idle}
        unused += (path for files in _unused(renamed, look).values() for path in files)
    finally:
        for path in aside:
            if path not in unused:
                _put_back(path)
    size = sum(path.stat().st_blocks * 512 for path in unused)
    for path in unused:
        path.unlink()
    return Removed(len(unused), size)


def _groups(folder: Path, group_of: Callable[[str], str]) -> dict[str, list[Path]]:
    """Regular files by group, with those that a killed rorg had set aside."""
    by_group: dict[str, list[Path]] = {}
    for path in sorted(folder.iterdir()):
        if (name := group_of(_name(path))) and path.is_file() and not path.is_symlink():
            by_group.setdefault(name, []).append(path)
    return by_group


def _older(files: Iterable[Path], before: float) -> bool:
    """Whether all of them are older; False if one has gone since."""
    try:
        return all(max(s.st_mtime, s.st_ctime) <= before for s in (path.stat() for path in files))
    except FileNotFoundError:
        return False


def _unused(groups: Mapping[str, list[Path]], look: Look) -> dict[str, list[Path]]:
    used = look([path for files in groups.values() for path in files]) if groups else set()
    return {name: files for name, files in groups.items() if used.isdisjoint(files)}


def _name(path: Path) -> str:
    return path.name.removeprefix(ASIDE)


def _set_aside(path: Path) -> Path:
    return path.rename(path.with_name(ASIDE + _name(path)))


def _put_back(path: Path) -> None:
    """Unless another file has its name by now: then only processes that have it open still need it."""
    with contextlib.suppress(FileExistsError):
        path.with_name(_name(path)).hardlink_to(path)
    path.unlink()


def _identity(path: Path) -> Identity | None:
    """None if it has gone since."""
    try:
        status = path.stat()
    except FileNotFoundError:
        return None
    return status.st_dev, status.st_ino


def _locked(path: Path) -> bool:
    """Whether a process holds its lock, which is how Fast DDS itself knows who lives."""
    if not path.name.endswith(LOCKS) or not path.exists():
        return False
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def _mapped(pid: str) -> Iterator[Identity]:
    """From lines like `7f1c-7f1d rw-s 00000000 00:1a 1234  /dev/shm/x`; see proc_pid_maps(5)."""
    with open(f"/proc/{pid}/maps", encoding="utf-8", errors="replace") as file:
        for line in file:
            device, inode = line.split(None, 5)[3:5]
            if inode != "0":
                major, _, minor = device.partition(":")
                yield os.makedev(int(major, 16), int(minor, 16)), int(inode)


def _open(pid: str, names: Container[str]) -> Iterator[Identity]:
    """Of these names. No other file is touched, because it may be one of a dead server."""
    for number in os.listdir(f"/proc/{pid}/fd"):
        path = f"/proc/{pid}/fd/{number}"
        with contextlib.suppress(FileNotFoundError):  # closed since
            if os.readlink(path).rpartition("/")[2] in names:
                status = os.stat(path)
                yield status.st_dev, status.st_ino
