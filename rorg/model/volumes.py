"""Volumes, devices and tmpfs mounts in their short form, one line of text."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

VOLUME_NAME = r"[a-zA-Z0-9][a-zA-Z0-9_.-]+"
ACCESS = ("rw", "ro")
PROPAGATION = ("private", "rprivate", "slave", "rslave", "shared", "rshared")
_MODES = (ACCESS, ("z", "Z"), PROPAGATION, ("nocopy",), ("consistent", "cached", "delegated"))
"""Groups of modes; at most one of each may be used."""
_FLAGS = """
rw ro suid nosuid dev nodev exec noexec sync async dirsync mand nomand atime noatime diratime nodiratime remount bind
rbind relatime norelatime strictatime nostrictatime defaults unbindable runbindable"""
_TMPFS_FLAGS = frozenset((*_FLAGS.split(), *PROPAGATION))
_TMPFS_VALUES = ("size", "mode", "uid", "gid", "nr_inodes", "nr_blocks", "mpol")


@dataclass(frozen=True, slots=True)
class Volume:
    """One line of `volumes`."""

    source: str
    """A path, the name of a volume, or "" for an unnamed volume."""
    target: str
    modes: tuple[str, ...] = ()


def is_path(source: str) -> bool:
    """Whether the source of a volume is a path of the host rather than a name."""
    return source.startswith(("/", "./", "../", "~/")) or source in (".", "..")


def parse_volume(text: str) -> Volume:
    """Parses SOURCE:/path/in/container[:MODES], or only a path in the container."""
    parts = text.split(":")
    if len(parts) > 3 or not is_target(parts[min(1, len(parts) - 1)]):
        raise ValueError(f"'{text}' is not a volume; write SOURCE:/path/in/container, with :ro for read only")
    if len(parts) == 1:
        return Volume("", text)
    source, modes = parts[0], tuple(parts[2].split(",")) if len(parts) == 3 else ()
    if not is_path(source) and not source.startswith(".") and not re.fullmatch(VOLUME_NAME, source):
        raise ValueError(f"'{text}' has no source that is a path or a volume; write ./{source or 'DIR'} for a path")
    foreign = PROPAGATION if re.fullmatch(VOLUME_NAME, source) else ("nocopy",)
    for mode in modes:
        if not any(mode in kind for kind in _MODES) or mode in foreign:
            raise ValueError(f"'{text}' has a mode '{mode}', which this volume cannot have; write ro, or nothing")
    if any(sum(mode in kind for mode in modes) > 1 for kind in _MODES):
        raise ValueError(f"'{text}' has modes that exclude each other")
    return Volume(source, parts[1], modes)


def is_target(path: str) -> bool:
    """Whether something can be mounted at this path."""
    return path.startswith("/") and path.strip("/") not in ("", ".")


def same_path(path: str) -> str:
    """Normalizes a path in a container."""
    return "/" + "/".join(part for part in path.split("/") if part not in ("", "."))


SINGLE_FILE = "file:"
"""Begins the digest of a mount that is one file. A container keeps the file that it was started with, also after git
or an editor has put another one in its place, so only another run reads that (Docker: bind mounts)."""
OF_TREE = "tree"
"""The type of a mount that the manifests of a service for any machine declare: its files travel with the service."""


class Mount(NamedTuple):
    """A mounted volume, read from its short or its long form."""

    source: str
    """A path of the host, the name of a volume, or "" for an unnamed volume."""
    target: str
    """The normalized path in the container."""
    read_only: bool

    @property
    def path(self) -> str:
        """Path on the host; empty for a named volume."""
        return self.source.rstrip("/") or "/" if self.source.startswith("/") else ""


def read_mount(volume: str | Mapping[str, Any]) -> Mount:
    """Reads a volume of a container that was checked."""
    if not isinstance(volume, str):
        return Mount(str(volume.get("source") or ""), same_path(volume["target"]), bool(volume.get("read_only")))
    source, colon, rest = volume.partition(":")
    target, _, modes = rest.partition(":")
    return Mount(source if colon else "", same_path(target if colon else source), "ro" in modes.split(","))


def mounted_at(volume: str | Mapping[str, Any]) -> str:
    """The normalized path of a volume in the container."""
    return read_mount(volume).target


def parse_device(text: str) -> tuple[str, str, str]:
    """Parses a device: (path on the host, path in the container, permissions)."""
    source, _, rest = text.partition(":")
    target, colon, access = rest.partition(":")
    sound = source.startswith("/") and (not rest or target.startswith("/")) and not (":" in text and not rest)
    if not sound or (colon and (not access or set(access) - set("rwm") or len(set(access)) < len(access))):
        raise ValueError(f"'{text}' is not a device; write /dev/NAME or /dev/NAME:/dev/NAME:rw")
    return source, target or source, access or "rwm"


def parse_tmpfs(text: str) -> tuple[str, str]:
    """Parses a tmpfs mount: (path, options)."""
    target, colon, options = text.partition(":")
    if not is_target(target) or (colon and not options):
        raise ValueError(f"'{text}' is not a tmpfs mount; write /path/in/container, with :size=64m behind it")
    for option in options.split(",") if options else ():
        name, equals, value = option.partition("=")
        if not (name in _TMPFS_VALUES and value) if equals else name not in _TMPFS_FLAGS:
            raise ValueError(f"'{text}' has an unknown option '{option}'; write size=64m or mode=1777")
    return target, options
