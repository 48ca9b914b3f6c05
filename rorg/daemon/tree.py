"""The tree of manifests as the loop sees it: read when it changed, never half, the last good one kept."""

from __future__ import annotations

import os
from pathlib import Path

from rorg.core.desired import Desired, desire
from rorg.errors import RorgError
from rorg.host.contents import Contents
from rorg.host.git import checkout_under_way, git_dir, revision
from rorg.manifest.catalog import EMPTY
from rorg.manifest.diagnostics import Diagnostic, Where
from rorg.manifest.load import load


class Tree:
    """`desired` is what the last good tree declares. While `errors` is not empty nothing is removed on its word."""

    def __init__(self, root: Path, run: str = "/run/rorg") -> None:
        self.root, self.run = root, run
        self.desired: Desired = desire(EMPTY)
        self.errors: tuple[Diagnostic, ...] = ()
        self.warnings: tuple[Diagnostic, ...] = ()
        self.revision = ""
        self.loaded = False
        """Whether any tree has been good yet."""
        self._stamp: tuple = ("never",)
        self._git = git_dir(root)
        self._contents = Contents()

    @property
    def removals(self) -> bool:
        """Whether the removal of undeclared services may be planned."""
        return self.loaded and not self.errors and len(self.desired.catalog.services) > 1

    def stamp(self) -> tuple:
        """Changes with every file of the tree: names, times, sizes."""
        found = []
        for folder, folders, files in os.walk(self.root):
            folders[:] = [f for f in folders if not f.startswith(".")]
            for name in files:
                path = os.path.join(folder, name)
                try:
                    # A link that leads nowhere is of the tree too.
                    stat = os.stat(path) if os.path.exists(path) else os.lstat(path)
                except OSError:
                    continue
                found.append((folder, name, stat.st_mtime_ns, stat.st_size, stat.st_ino))
        return tuple(sorted(found))

    def read(self) -> tuple[bool, bool]:
        """(something new was learnt, look again soon). A checkout in progress, or a tree that changes while it is
        read, is left for later."""
        if checkout_under_way(self._git):
            return False, True
        stamp = self.stamp()
        if stamp == self._stamp:
            return False, False
        contents: dict[str, dict[str, str]] = {}
        try:
            loaded = load(self.root)
            catalog, diagnostics = loaded.catalog, loaded.diagnostics
            contents = self._contents.of(catalog, self.root) if catalog else {}
        except RorgError as error:
            catalog, diagnostics = None, (Diagnostic(Where(str(self.root)), str(error)),)
        if self.stamp() != stamp or checkout_under_way(self._git):
            return False, True
        self._stamp = stamp
        self.errors = tuple(d for d in diagnostics if d.severity == "error")
        self.warnings = tuple(d for d in diagnostics if d.severity == "warning")
        if catalog is not None:
            self.desired, self.loaded = desire(catalog, self.run, contents), True
            self.revision = revision(self.root)
        return True, False
