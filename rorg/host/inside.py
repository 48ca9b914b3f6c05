"""Looking at a file as whoever is inside another root sees it, such as a container's. A link in there means a place in
there; the kernel, asked for /proc/PID/root/LINK, goes from an absolute link to a file of this machine."""

from __future__ import annotations

import errno
import os
import stat

MOST_LINKS = 40
"""On the way to one file, as in the kernel."""
MOST_DEPTH = 64
"""Directories below each other, each of which costs a descriptor meanwhile."""


def modified(root: str, path: str) -> float:
    """When the file at an absolute path below `root` was written last, seconds since the epoch. Nothing is opened but
    as a place (O_PATH), so that no pipe or device waits or does anything. Raises OSError."""
    place = os.open(root, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    way, pending, links = [place], _names(path), 0
    try:
        while pending:
            name = pending.pop()
            if name == "..":
                if len(way) > 1:
                    os.close(way.pop())
                continue
            # What was judged is what is gone on from, also while somebody in there renames.
            found = os.open(name, os.O_PATH | os.O_NOFOLLOW | os.O_CLOEXEC, dir_fd=way[-1])
            way.append(found)
            if len(way) > MOST_DEPTH:
                raise OSError(errno.ENAMETOOLONG, os.strerror(errno.ENAMETOOLONG))
            if stat.S_ISLNK(os.fstat(found).st_mode):
                target, links = os.readlink("", dir_fd=found), links + 1
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
    """Of the path, the first one last."""
    return [name for name in reversed(path.split("/")) if name not in ("", ".")]
