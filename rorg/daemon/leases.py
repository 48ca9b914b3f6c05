"""Reads the requests file for the loop, removes from it what is over, and counts renewals of leases."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from rorg.core.decide import Decision
from rorg.core.holds import Moment, adjusted
from rorg.daemon.recorder import Recorder
from rorg.errors import RorgError
from rorg.model.catalog import Hold, Request
from rorg.store.requests_document import RequestsDocument
from rorg.store.requests_file import RequestsFile

Key = tuple[str, str]
"""(requester, id)."""
UNKNOWN = Hold(
    253402300799.0, "the requests file has an error, and there is no earlier version to use; try `rorg diff` to see it"
)
"""While the requests are not known, everything that runs keeps running."""
MANY = 1000
"""Renewals to remember; beyond that, those of requests that are gone are forgotten."""


class Leases:
    """Only renew() and note() may be called from other threads than the loop's."""

    def __init__(self, path: Path, recorder: Recorder) -> None:
        self.file, self.recorder = RequestsFile(path), recorder
        self.committed: RequestsFile | None = None
        """The file as the API writes it, if there is one: what it has written need not be read."""
        self._lock = threading.Lock()
        """Held so that no renewed request is dropped, and none that is being dropped is renewed."""
        self._renewals: dict[Key, int] = {}
        """The number of the last renewal of each request through the API; no number is used twice."""
        self._numbers = itertools.count(1)
        self._ending: set[Key] = set()
        """Requests that are being dropped now."""

    def read(self) -> None:
        """Read the file if it has changed."""
        try:
            if self.committed is not None:
                self.file.take(self.committed)
            self.file.read()
            self.file.keep()
        except OSError as error:
            self.recorder.when_new("requests-not-kept", str(error), "requests-not-kept", str(error))

    def document(self) -> RequestsDocument:
        """What counts now: the last good content."""
        document = self.file.document
        return replace(document, suspended=UNKNOWN) if self.file.diagnostics and not self.file.good else document

    def renewals(self) -> dict[Key, int]:
        with self._lock:
            if len(self._renewals) > MANY:
                kept = {r.key for r in self.file.document.requests}
                self._renewals = {key: n for key, n in self._renewals.items() if key in kept}
            return dict(self._renewals)

    def note(self, key: Key) -> None:
        """A request was put through the API."""
        with self._lock:
            self._renewals[key] = next(self._numbers)

    def renew(
        self, key: Key, committed: RequestsFile, allow: Callable[[Request], None] = lambda _: None
    ) -> Request | None:
        """Count a renewal of a request; None if it does not exist any more. `committed` is the file after the last
        acknowledged change, which the loop may not have read yet; while the file is broken, the last good content
        counts. `allow` raises if this request may not be renewed."""
        with self._lock:
            document = self.file.document if self.file.diagnostics else committed.now()
            request = next((r for r in document.requests if r.key == key), None)
            if request is None or key in self._ending:
                return None
            allow(request)
            self._renewals[key] = next(self._numbers)
            return request

    def settle(self, decision: Decision, renewals: Mapping[Key, int]) -> None:
        """Write down which requests were dropped or bound, and which restarts and retries are done. The file has
        precedence: an entry that was changed since it was read, or renewed (`renewals` are those that the decision
        knew), stays."""
        settled = decision.settled
        if not (settled.dropped or settled.bound or decision.served or decision.retried or decision.confirmed):
            return
        gone = {r.key: r for r, _ in settled.dropped}
        bound = {r.key: r.incarnation for r in settled.bound}
        dropped: set[Key] = set()

        def edit(document: RequestsDocument) -> RequestsDocument:
            with self._lock:
                dropped.update(
                    r.key
                    for r in document.requests
                    if r.key in gone and _same(r, gone[r.key]) and self._renewals.get(r.key) == renewals.get(r.key)
                )
                self._ending |= dropped
            left = [r for r in document.requests if r.key not in dropped]
            return replace(
                document,
                requests=tuple(replace(r, incarnation=r.incarnation or bound.get(r.key)) for r in left),
                restarts={n: at for n, at in document.restarts.items() if decision.served.get(n) != at},
                retries={n: at for n, at in document.retries.items() if decision.retried.get(n) != at},
                removals=tuple(n for n in document.removals if n not in decision.confirmed),
            )

        try:
            if not self._change(edit):
                return
        finally:
            with self._lock:
                self._ending -= dropped
        for request, why in settled.dropped:
            if request.key in dropped:
                self._tell_dropped(request, why)

    def follow_clock(self, now: Moment) -> None:
        """Write down when holds end by a clock that was set, or after a reboot."""
        if _at(self.file.document, now) is not self.file.document:
            self._change(lambda document: _at(document, now))

    def _change(self, edit: Callable[[RequestsDocument], RequestsDocument]) -> bool:
        """Change the file; False, and an event, if that is not possible."""
        try:
            self.file.change(edit)
        except (RorgError, OSError) as error:
            self.recorder.when_new("requests-not-written", str(error), "requests-not-written", str(error))
            return False
        return True

    def _tell_dropped(self, request: Request, why: str) -> None:
        self.recorder.event(
            "request-dropped",
            f"request '{request.id}' of {request.requester} dropped: {why}",
            service=request.requester,
            services=list(request.services),
            request=request.id,
        )


def _at(document: RequestsDocument, now: Moment) -> RequestsDocument:
    """Return the content with the ends of its holds by the present clock; the same object if they have not changed."""
    held = [*document.holds.values(), *([document.suspended] if document.suspended else [])]
    if all(adjusted(hold, now) is hold for hold in held):
        return document
    holds = {name: adjusted(hold, now) for name, hold in document.holds.items()}
    return replace(document, holds=holds, suspended=document.suspended and adjusted(document.suspended, now))


def _same(one: Request, other: Request) -> bool:
    """Whether they say the same, wherever they are in the file."""
    return replace(one, where=other.where) == other
