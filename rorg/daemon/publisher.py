"""Publishes the state of everything in a file, which commands read if they cannot use the API."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rorg.core.decide import Decision
from rorg.core.masking import Masker
from rorg.daemon.snapshot import Snapshots, about_tree
from rorg.daemon.tree import Tree
from rorg.store.files import write_atomic
from rorg.store.requests_file import RequestsFile
from rorg.store.state_dir import StateDir

AFTER = 0.025
"""Seconds from a pass to its publication, so that it takes no CPU from the calls that just began."""
EVERY = 0.05
"""Seconds between two published states, at least."""
SHARE = 0.1
"""Share of the time that publishing may take: a robot with many changing services has other work to do."""


class Publisher:
    """`about` says which rorg this is; `tell` gets errors; `clock` gives monotonic seconds. What `masker` hides is not
    published."""

    def __init__(
        self,
        state: StateDir,
        clock: Callable[[], float],
        about: Callable[[], Mapping[str, Any]],
        tell: Callable[[str], None],
        masker: Masker,
    ) -> None:
        self.masker = masker
        self.state, self.clock, self.about, self.tell = state, clock, about, tell
        self._snapshots = Snapshots()
        self._published = ""
        self._due = 0.0
        self._next: dict[str, Any] | None = None
        """What flush() will publish beside the decision."""

    def note(self, decision: Decision) -> None:
        """Must be called with every decision, before anyone else sees it."""
        self._snapshots.note(decision)

    def text(self, about: dict[str, Any]) -> str:
        """The whole state as of the last decision, as StatusView. Any thread may ask."""
        return self._snapshots.text({**self.about(), **about})

    def publish(self, tree: Tree, requests: RequestsFile) -> None:
        """Keep the state until flush() publishes it."""
        if self._next is None:
            self._due = max(self.clock() + AFTER, self._due)
        self._next = {**self.about(), **about_tree(tree, requests)}

    def due(self) -> float | None:
        """When the kept state must be published; None if all that is known has been."""
        return self._due if self._next is not None else None

    def flush(self) -> None:
        """Write the kept state if it has changed."""
        if self._next is None:
            return
        began = self.clock()
        try:
            self._write(self._next)
        finally:
            self._next, ended = None, self.clock()
            self._due = ended + max(EVERY, (ended - began) / SHARE)

    def _write(self, about: dict[str, Any]) -> None:
        text = self.masker.json(self._snapshots.text(about))
        if text == self._published:
            return
        self._published = text
        try:
            write_atomic(self.state.status, text, durable=False)
        except OSError as error:
            # A full disk must not stop the robot; the next change is tried again.
            self._published = ""
            self.tell(f"cannot publish the status: {error}")
