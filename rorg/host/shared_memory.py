"""Files of shared memory: which of them no process uses, and removing those."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Callable, Collection, Container, Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

SHM = Path("/dev/shm")
ASIDE = ".rorg-"
"""Begin of the name of a file that is about to be removed."""
ALL_PROCESSES = 0xEFFFFFFC
"""Inode of the first namespace of process ids (PROC_PID_INIT_INO of the kernel): who lives in it sees all of them."""
INIT = "1"
"""Process that is no participant, and on some machines lets not even root see what it has mapped."""
LOCKS = ("_el", "_sl")

Identity = tuple[int, int]
"""Device and inode."""
Look = Callable[[Collection[Path]], set[Path]]


class Removed(NamedTuple):
    """What is no more."""

    files: int = 0
    size: int = 0
    """Bytes."""


def in_use(files: Collection[Path]) -> set[Path]:
    """Those that any process of this machine has open, mapped or locked. Raises PermissionError where that cannot be
    seen: without root's rights, or inside a container that has processes of its own."""
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
    """Removes groups of files of which none is in use, and none younger than `before` (seconds since the epoch). The
    group of a name that is to stay is empty. Raises OSError where it cannot be seen what is used: nothing is removed.
    """
    groups = {name: files for name, files in _groups(folder, group_of).items() if _older(files, before)}
    idle = _unused(groups, look)
    # Under another name nobody can open them any more: who has done so since the first look is seen by the second.
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
    """Regular files by group, also those that were set aside by a rorg that was killed then."""
    found: dict[str, list[Path]] = {}
    for path in sorted(folder.iterdir()):
        if (name := group_of(_name(path))) and path.is_file() and not path.is_symlink():
            found.setdefault(name, []).append(path)
    return found


def _older(files: Iterable[Path], before: float) -> bool:
    """Whether all of them are older; False where one has gone since."""
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
    """Unless another one has its name by now: then only who has it open still needs it."""
    with contextlib.suppress(FileExistsError):
        path.with_name(_name(path)).hardlink_to(path)
    path.unlink()


def _identity(path: Path) -> Identity | None:
    """None where it has gone since."""
    try:
        status = path.stat()
    except FileNotFoundError:
        return None
    return status.st_dev, status.st_ino


def _locked(path: Path) -> bool:
    """Whether somebody holds its lock, by which Fast DDS itself knows who lives."""
    if not path.name.endswith(LOCKS) or not path.exists():
        return False
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def _mapped(pid: str) -> Iterator[Identity]:
    """By lines like `7f1c-7f1d rw-s 00000000 00:1a 1234  /dev/shm/x`; see proc_pid_maps(5)."""
    with open(f"/proc/{pid}/maps", encoding="utf-8", errors="replace") as file:
        for line in file:
            device, inode = line.split(None, 5)[3:5]
            if inode != "0":
                major, _, minor = device.partition(":")
                yield os.makedev(int(major, 16), int(minor, 16)), int(inode)


def _open(pid: str, names: Container[str]) -> Iterator[Identity]:
    """Of these names; no other file is touched, since it may be one of a dead server."""
    for number in os.listdir(f"/proc/{pid}/fd"):
        path = f"/proc/{pid}/fd/{number}"
        with contextlib.suppress(FileNotFoundError):  # closed since
            if os.readlink(path).rpartition("/")[2] in names:
                status = os.stat(path)
                yield status.st_dev, status.st_ino
