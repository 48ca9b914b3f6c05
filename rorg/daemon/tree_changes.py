"""Changes of the tree's files since the last reading, as the kernel reports them: whether one has changed, and whether
those that services mount are still being written. The tree asks in each reading, the loop before it serves a request.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from rorg.host.contents import Stats, stat_of

REST = 0.5
"""Seconds without a change before a change of mounted files counts: some are written all the time."""
PATIENCE = 2.0
"""Seconds for which somebody waits until they rest."""


class TreeChanges:
    """`unsettled`: mounted paths, as in Desired.contents, that are being written and were not read yet. Nobody waits
    for them longer than PATIENCE."""

    def __init__(self) -> None:
        self.unsettled: frozenset[str] = frozenset()
        self._mounts: tuple[Stats, float] = (), 0.0
        """(what is mounted, as of the last look; since when it has been so)."""
        self._unrest: float | None = None
        """Since when mounted files have been written without a rest, and were not read."""
        self._known: Stats = ()
        """All files and folders of the tree at the last reading."""

    @property
    def restless(self) -> bool:
        """Whether mounted files have been written for so long that nobody waits for them any more."""
        return self._unrest is not None and not self.unsettled

    def rest(self, mounts: Stats, now: float) -> bool:
        """Return whether what is mounted has not changed for a while: a file that is written all the time, or half
        written, must not restart anything."""
        if self._mounts[0] != mounts:
            self._mounts = mounts, now
        return now - self._mounts[1] >= REST

    def note_unsettled(self, before: Stats, mounted: Mapping[str, str], now: float) -> None:
        """Note what is being written. `before`: what was mounted at the last reading; `mounted`: mounted paths, each
        with its place."""
        self._unrest = now if self._unrest is None else self._unrest
        changed = {*before} ^ {*self._mounts[0]} if now - self._unrest < PATIENCE else ()
        places = [f"{path}/" for path, *_ in changed]
        self.unsettled = frozenset(
            path for path, place in mounted.items() if any(changed.startswith(f"{place}/") for changed in places)
        )

    def settled(self, stamp: Iterable[Stats], folders: Iterable[Path]) -> None:
        """Note that everything has been read as it was at a stamp. `folders` have its files."""
        self._unrest, self.unsettled = None, frozenset()
        known = {of[0]: of for part in stamp for of in part}
        self._known = (
            *known.values(),
            *(of for path in map(str, folders) if path not in known and (of := stat_of(path))),
        )

    def differ(self) -> bool:
        """Return whether a file or folder differs from the last reading. Each request asks, so this is much cheaper
        than a stamp of the tree: some 3 microseconds a file."""
        return any(stat_of(str(known[0])) != known for known in self._known)
