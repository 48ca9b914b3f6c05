"""Files of this machine inside containers."""

from __future__ import annotations

import os
import posixpath
import stat
from collections.abc import Iterator

from rorg.manifest.files import real
from rorg.manifest.validation.robot import Finding, Robot, each
from rorg.manifest.validation.subject import Subject
from rorg.manifest.validation.texts import named_files, read
from rorg.model.diagnostics import HINT
from rorg.model.run_directory import RUN
from rorg.model.volumes import Mount

ENGINES = ("docker.sock", "podman.sock", "containerd.sock", "crio.sock")
OURS = "rorg.sock"
SHARED = ("/", "/run", "/tmp", "/var/run")
"""Directories that hold the sockets of many programs, and much else."""
SYSTEM = ("/bin", "/etc", "/lib", "/lib64", "/opt", "/opt/ros", "/sbin", "/usr", "/usr/bin", "/usr/lib", "/var")
HOST = ("/", "/etc", "/proc", "/root", "/home", "/usr", "/var", "/var/lib/docker")
MOST_ENTRIES = 500
"""Maximum number of entries checked in a mounted directory."""


def _sockets(subject: Subject) -> Iterator[Finding]:
    for mount in subject.mounts:
        name = posixpath.basename(mount.path)
        if mount.source.startswith(RUN) or not name.endswith(".sock"):
            continue
        where = subject.volume(mount)
        if name in ENGINES:
            message = f"'{subject.name}' may tell the engine anything: it is root on this machine"
            yield Finding("engine-socket-mounted", where, message)
            continue
        message = f"{mount.path} is a socket file. Its program creates a new one when it restarts, and "
        message += f"'{subject.name}' keeps the dead one"
        folder = posixpath.dirname(mount.path)
        remedy = f"{folder}, its directory" if folder not in SHARED else "a directory of its own for the socket"
        yield Finding("socket-file-mounted", where, message, remedy, "error" if name == OURS else "warning")


def _sources(robot: Robot) -> Iterator[Finding]:
    """Missing sources of mounts inside the tree: the engine would create an empty directory."""
    told = set[str]()
    for subject, mount in ((s, m) for s in robot.subjects for m in _of_tree(s)):
        if not os.path.lexists(mount.path):
            message = f"{_shown(subject, mount)} does not exist, and the engine creates an empty directory there"
            data = not mount.read_only and not posixpath.splitext(mount.path)[1]  # an empty directory may be meant
            severity = HINT if data or mount.path in told else ""
            told |= set() if data else {mount.path}
            yield Finding("missing-mount-source", subject.volume(mount), message, severity=severity)
            continue
        dead = next(_dead_links(mount.path), "")
        if dead:
            message = f"{_shown(subject, mount)} contains a dead link: {dead}"
            yield Finding("missing-mount-source", subject.volume(mount), message, "to mend or delete the link")


def _of_tree(subject: Subject) -> Iterator[Mount]:
    """Mounts whose source is in the tree, or is written relative to it."""
    volumes = subject.written_list("container", "volumes")
    written = [str(v.get("source") if isinstance(v, dict) else v).partition(":")[0].rstrip("/") for v in volumes]
    relative = [source for source in written if source.startswith(("./", "../", "~/"))]
    for mount in (m for m in subject.mounts if m.path):
        tail = posixpath.basename(mount.path)
        if mount in subject.mounts_of_tree or any(source.endswith(tail) for source in relative):
            yield mount


def _shown(subject: Subject, mount: Mount) -> str:
    return os.path.relpath(mount.path, real(subject.source.directory))


def _dead_links(path: str) -> Iterator[str]:
    """Dead relative links. Absolute ones may exist in the container."""
    try:
        with os.scandir(path) as entries:
            for number, entry in enumerate(entries):
                if number >= MOST_ENTRIES:
                    return
                dead = entry.is_symlink() and not os.path.exists(entry.path)
                if dead and not os.readlink(entry.path).startswith("/"):
                    yield entry.name
    except OSError:
        return


def _hiding(subject: Subject) -> Iterator[Finding]:
    for mount in subject.mounts:
        if mount.target in SYSTEM and mount.source:
            message = f"the mount hides the image's own {mount.target}"
            yield Finding("mount-over-system", subject.volume(mount), message)
        if mount.path in HOST and not mount.read_only:
            message = f"'{subject.name}' may write to {mount.path} of this machine"
            yield Finding("whole-host-mounted", subject.volume(mount), message)


def _files(subject: Subject) -> Iterator[Finding]:
    """Files of the tree in the command: whether they exist and can be executed."""
    starts = {command[0] for command in subject.commands if command}
    for word, path in named_files(subject):
        if not os.path.lexists(path):
            shown = os.path.relpath(path, real(subject.source.directory))
            if not any(m.path == path or (not m.read_only and path.startswith(f"{m.path}/")) for m in subject.mounts):
                message = f"{word} would be {shown}, which does not exist"
                yield Finding("missing-file", subject.command(), message)
        elif word in starts and os.path.isfile(path):
            yield from _program(subject, path, os.path.relpath(path, real(subject.source.directory)))


def _program(subject: Subject, path: str, shown: str) -> Iterator[Finding]:
    mode = os.stat(path).st_mode
    if stat.S_ISREG(mode) and not mode & 0o111:
        message = f"{shown} is not executable"
        yield Finding("program-not-executable", subject.command(), message, f"chmod +x {shown}, or a shell before it")
    first = read(path, subject.source.root).partition("\n")[0]
    if first.startswith("#!") and first.endswith("\r"):
        message = f"the first line of {shown} ends as on Windows: no such interpreter is found"
        yield Finding("script-with-crlf", subject.command(), message)


CHECKS = (_sources, *map(each, (_sockets, _hiding, _files)))
