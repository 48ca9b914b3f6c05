"""Looks at a file as a process with another root sees it, such as a container's. A link must lead to a place inside,
but the kernel follows an absolute link below /proc/PID/root to a file of this machine."""

from __future__ import annotations

import errno
import os
import stat

MOST_LINKS = 40
"""Links on the way to one file, as in the kernel."""
MOST_DEPTH = 64
"""Nested directories, each of which needs an open descriptor."""


def modified(root: str, path: str) -> float:
    """When the file at an absolute path below `root` was last modified, seconds since the epoch. Files are opened only
    as places (O_PATH), so that no pipe or device waits or does anything. Raises OSError."""
    place = os.open(root, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    way, pending, links = [place], _names(path), 0
    try:
        while pending:
            name = pending.pop()
            if name == "..":
                if len(way) > 1:
                    os.close(way.pop())
                continue
            # Go on from what was checked, even if someone inside renames it meanwhile.
            handle = os.open(name, os.O_PATH | os.O_NOFOLLOW | os.O_CLOEXEC, dir_fd=way[-1])
            way.append(handle)
            if len(way) > MOST_DEPTH:
                raise OSError(errno.ENAMETOOLONG, os.strerror(errno.ENAMETOOLONG))
            if stat.S_ISLNK(os.fstat(handle).st_mode):
                target, links = os.readlink("", dir_fd=handle), links + 1
                if links > MOST_LINKS:
                    raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))
                for _ in range(len(way) - 1 if target.startswith("/") else 1):
                    os.close(way.pop())
                pending += _names(target)
        return os.fstat(way[-1]).st_mtime
    finally:
        for descriptor in way:
            os.close(descriptor)


def _names(path: str) -> list[str]:
    """The names of the path, the first one last."""
    return [name for name in reversed(path.split("/")) if name not in ("", ".")]
