"""Durable changes of the requests file for many callers: all that wait at the same time share one write and fsync."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future

from rorg.errors import Unreachable
from rorg.store.requests_file import Asked, RequestsFile

Edit = Callable[[Asked], Asked]
"""From what is asked now to what is asked then; raises RorgError to refuse, and then nothing of it is done."""


def _told(error: Exception) -> Exception:
    if isinstance(error, OSError):
        return Unreachable("write the requests file", error.strerror or str(error), "to make room on the disk")
    return error


class Committer:
    """A thread that applies edits in the order in which they came."""

    def __init__(self, file: RequestsFile) -> None:
        self.file = file
        self._edits: queue.SimpleQueue[tuple[Edit, Future[Asked]] | None] = queue.SimpleQueue()

    def start(self) -> None:
        threading.Thread(target=self._run, name="committer", daemon=True).start()

    def stop(self) -> None:
        self._edits.put(None)

    def submit(self, edit: Edit) -> Future[Asked]:
        """The future is done when the disk has it, or holds the error with which it was refused."""
        future: Future[Asked] = Future()
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

    def _commit(self, batch: list[tuple[Edit, Future[Asked]]]) -> None:
        refused: dict[int, Exception] = {}

        def apply(asked: Asked) -> Asked:
            for index, (edit, _) in enumerate(batch):
                try:
                    asked = edit(asked)
                except Exception as error:
                    refused[index] = error
            return asked

        try:
            after = self.file.change(apply)
        except Exception as error:
            if len(batch) > 1:
                for entry in batch:  # what one of them spoils is not the others' fault
                    self._commit([entry])
                return
            batch[0][1].set_exception(_told(error))
            return
        for index, (_, future) in enumerate(batch):
            if index in refused:
                future.set_exception(refused[index])
            else:
                future.set_result(after)
