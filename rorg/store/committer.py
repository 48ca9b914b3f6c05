"""Makes durable changes of the requests file for many callers. Changes that wait at the same time share one write and
fsync, and callers take turns, so that none waits for all changes of another."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future

from rorg.errors import Busy, Unreachable
from rorg.store.requests_document import RequestsDocument
from rorg.store.requests_file import RequestsFile

PATIENCE = 5.0
"""Seconds that stop() waits for a write under way."""
MOST_AT_ONCE = 256
"""Changes that share one write."""
MOST_OF_ONE = 16
"""Of these, changes of one caller."""

Edit = Callable[[RequestsDocument], RequestsDocument]
"""Returns the changed document; raises RorgError to refuse, and then changes nothing."""


def _told(error: Exception) -> Exception:
    if isinstance(error, OSError):
        return Unreachable("write the requests file", error.strerror or str(error), "to free space on the disk")
    return error


Entry = tuple[Edit, Future[int]]


class Turns:
    """Waiting changes by caller: in order for each caller, and one of each caller in turn."""

    def __init__(self) -> None:
        self._waiting: dict[str, deque[Entry]] = {}

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def put(self, caller: str, entry: Entry) -> None:
        self._waiting.setdefault(caller, deque()).append(entry)

    def take(self) -> list[Entry]:
        """Return the changes of the next write. The caller that had the last turn comes last next time."""
        entries: list[Entry] = []
        for _ in range(MOST_OF_ONE):
            for caller in list(self._waiting)[: MOST_AT_ONCE - len(entries)]:
                waiting = self._waiting.pop(caller)
                entries.append(waiting.popleft())
                if waiting:
                    self._waiting[caller] = waiting
        return entries


class Committer:
    """A thread that applies edits, those of each caller in their order."""

    def __init__(self, file: RequestsFile, changed: Callable[[bool], int]) -> None:
        """`changed` is called for every write with whether anything changed, and returns the generation, as soon as the
        loop may act on it. Callers are answered when it is on the disk.

        In between, only a loss of power can take a change back, which ends all that the loop has started too. Nothing
        is acted on before it is in its place: what the disk refuses was never asked for."""
        self.file, self.changed = file, changed
        self._turns, self._news, self._stopped = Turns(), threading.Condition(), False
        self._thread = threading.Thread(target=self._run, name="committer", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """End when everything submitted before is done."""
        with self._news:
            self._stopped = True
            self._news.notify()
        if self._thread.is_alive():
            self._thread.join(PATIENCE)

    def submit(self, edit: Edit, caller: str = "") -> Future[int]:
        """Return a future of the change's generation, set once the change is on the disk, or of the error that refused
        it. It cannot be cancelled: a submitted change is made even if its caller stops waiting."""
        future: Future[int] = Future()
        future.set_running_or_notify_cancel()
        with self._news:
            if self._stopped:
                future.set_exception(Busy("write the requests file", "rorg is being stopped", "again in a moment"))
            else:
                self._turns.put(caller, (edit, future))
                self._news.notify()
        return future

    def _run(self) -> None:
        while batch := self._next():
            self._commit(batch)

    def _next(self) -> list[Entry]:
        """The next changes; none at the end."""
        with self._news:
            self._news.wait_for(lambda: self._turns or self._stopped)
            return self._turns.take()

    def _commit(self, batch: list[Entry]) -> None:
        refused: dict[int, Exception] = {}

        def apply(document: RequestsDocument) -> RequestsDocument:
            for index, (edit, _) in enumerate(batch):
                try:
                    document = edit(document)
                except Exception as error:
                    refused[index] = error
            return document

        generations: list[int] = []
        try:
            self.file.change(apply, False, lambda: generations.append(self.changed(True)))
        except Exception as error:
            if len(batch) > 1:
                for entry in batch:  # one broken change must not affect the others
                    self._commit([entry])
                return
            batch[0][1].set_exception(_told(error))
            return
        generation = generations[0] if generations else self.changed(False)
        for index, (_, future) in enumerate(batch):
            if index in refused:
                future.set_exception(refused[index])
            else:
                future.set_result(generation)
