"""Durable changes of the requests file for many callers: all that wait at the same time share one write and fsync."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future

from rorg.errors import Busy, Unreachable
from rorg.store.requests_document import RequestsDocument
from rorg.store.requests_file import RequestsFile

PATIENCE = 5.0
"""Seconds that stop() waits for a write under way."""

Edit = Callable[[RequestsDocument], RequestsDocument]
"""From what is asked now to what is asked then; raises RorgError to refuse, and then nothing of it is done."""


def _told(error: Exception) -> Exception:
    if isinstance(error, OSError):
        return Unreachable("write the requests file", error.strerror or str(error), "to make room on the disk")
    return error


class Committer:
    """A thread that applies edits in the order in which they came."""

    def __init__(self, file: RequestsFile, changed: Callable[[bool], int]) -> None:
        """`changed` is told of every write that is on the disk, whether it changed anything, and gives the generation
        of it."""
        self.file, self.changed = file, changed
        self._edits: queue.SimpleQueue[tuple[Edit, Future[int]] | None] = queue.SimpleQueue()
        self._lock, self._stopped = threading.Lock(), False
        self._thread = threading.Thread(target=self._run, name="committer", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Ends when what was submitted before is done."""
        with self._lock:
            self._stopped = True
            self._edits.put(None)
        if self._thread.is_alive():
            self._thread.join(PATIENCE)

    def submit(self, edit: Edit) -> Future[int]:
        """The future has the change's generation when the disk has it, or the error with which it was refused."""
        future: Future[int] = Future()
        with self._lock:
            if self._stopped:
                future.set_exception(Busy("write the requests file", "rorg is being stopped", "again in a moment"))
            else:
                self._edits.put((edit, future))
        return future

    def _run(self) -> None:
        while (first := self._edits.get()) is not None:
            batch = [first]
            while not self._edits.empty() and len(batch) < 256:
                more = self._edits.get()
                if more is None:
                    self._edits.put(None)
                    break
                batch.append(more)
            self._commit(batch)

    def _commit(self, batch: list[tuple[Edit, Future[int]]]) -> None:
        refused: dict[int, Exception] = {}

        def apply(document: RequestsDocument) -> RequestsDocument:
            for index, (edit, _) in enumerate(batch):
                try:
                    document = edit(document)
                except Exception as error:
                    refused[index] = error
            return document

        before = self.file.document
        try:
            after = self.file.change(apply, notify=False)
        except Exception as error:
            if len(batch) > 1:
                for entry in batch:  # what one of them spoils is not the others' fault
                    self._commit([entry])
                return
            batch[0][1].set_exception(_told(error))
            return
        generation = self.changed(after != before)
        for index, (_, future) in enumerate(batch):
            if index in refused:
                future.set_exception(refused[index])
            else:
                future.set_result(generation)
