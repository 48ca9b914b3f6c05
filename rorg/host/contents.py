"""What is in the files of the tree that services mount, as digests: a change of them is seen, and its revert."""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path

from rorg.host.file_digests import FileDigests
from rorg.model.catalog import Catalog, Spec

MOST_FILES = 5000
MOST_BYTES = 64 << 20
"""Of one mount. What is bigger is data, not configuration: its changes are the service's own affair."""


class Contents:
    """Remembers digests of files by what stat says of them, so that only what changed is read again."""

    def __init__(self) -> None:
        self.files = FileDigests()

    def of(self, catalog: Catalog, root: Path) -> dict[str, dict[str, str]]:
        """Service -> path below the tree -> digest of what is there. Services that do not care are left out."""
        base, found, mounts = str(root.resolve()), dict[str, dict[str, str]](), dict[str, str]()
        self.files.begin()
        for name, service in catalog.services.items():
            if service.spec is None or service.on_change == "none":
                continue
            for source in mounted(service.spec, base):
                if source not in mounts:
                    mounts[source] = self._digest(source)
            there = {os.path.relpath(s, base): d for s in mounted(service.spec, base) if (d := mounts[s])}
            if there:
                found[name] = there
        return found

    def _digest(self, source: str) -> str:
        """ "" for what cannot be told."""
        files, size = [], 0
        for path, facts in walk(source):
            files.append((path, facts))
            size += facts.st_size
            if len(files) > MOST_FILES or size > MOST_BYTES:
                return ""
        digest = hashlib.sha256()
        for path, facts in sorted(files, key=lambda f: f[0]):
            said = self.files.of(path, facts)
            runs = bool(facts.st_mode & stat.S_IXUSR)
            digest.update(f"{os.path.relpath(path, source)}\0{runs}\0{said}\0".encode(errors="surrogateescape"))
        return digest.hexdigest()[:16] if files else "empty"


def mounted(spec: Spec, base: str) -> list[str]:
    """What of the tree below `base` a container gets to read. What it may write is its own."""
    found = []
    for volume in spec.get("volumes", ()):
        if isinstance(volume, Mapping):
            source = volume.get("source", "") if volume.get("type") == "bind" and volume.get("read_only") else ""
        else:
            source, _, rest = volume.partition(":")
            source = source if "ro" in rest.partition(":")[2].split(",") else ""
        if source.startswith(f"{base}/"):
            found.append(os.path.normpath(source))
    return list(dict.fromkeys(found))


def walk(source: str) -> Iterator[tuple[str, os.stat_result]]:
    """Regular files and links of a mount that count. Hidden ones belong to editors and version control, not to the
    service."""
    if not os.path.isdir(source):
        yield from _one(source)
    for folder, folders, files in os.walk(source):
        links = [f for f in folders if os.path.islink(os.path.join(folder, f))]
        folders[:] = [f for f in folders if not f.startswith(".") and f != "__pycache__"]
        for name in (*files, *links):
            if not name.startswith(".") and not name.endswith("~"):
                yield from _one(os.path.join(folder, name))


def _one(path: str) -> Iterator[tuple[str, os.stat_result]]:
    try:
        facts = os.lstat(path)
    except OSError:
        return
    if stat.S_ISREG(facts.st_mode) or stat.S_ISLNK(facts.st_mode):
        yield path, facts
