"""The requests file: read when it has changed, and changed under a lock, in one step, durably."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rorg.errors import Invalid
from rorg.model.diagnostics import Diagnostic, Where
from rorg.store import wakeup
from rorg.store.files import locked, read_state, write_atomic
from rorg.store.requests_document import RequestsDocument
from rorg.store.requests_parser import parse, render

SPARE = ".requests.last-good.yaml"
"""The content that counts while the file is broken, even after a restart of rorg."""


class RequestsFile:
    """Reads the file when it has changed, and changes it under a lock, in one step, with fsync."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._stamp: tuple[int, ...] | None = None
        self.document = RequestsDocument()
        """The last good content."""
        self.good = False
        """Whether any content has been good yet."""
        self.written: tuple[RequestsDocument, tuple[int, ...] | None] = self.document, None
        """The content that was last written here, with its stamp."""
        self.diagnostics: list[Diagnostic] = []
        """The errors of the current content; the last good one counts meanwhile."""

    def read(self) -> bool:
        """Look at the file; return whether it has new good content. A file that cannot be read is tried each time."""
        stamp = self._now()
        if stamp is not None and stamp == self._stamp:
            return False
        document, self.diagnostics, read = _content(self.path)
        self._stamp = stamp if read else None
        if document is None:
            return False
        self.good, changed = True, document != self.document
        self.document = document
        return changed

    @property
    def known(self) -> bool:
        """Whether the file is as it was when it was last read or written here."""
        return self._stamp is not None and self._now() == self._stamp

    def take(self, other: RequestsFile) -> None:
        """Take what `other` has written, so that it need not be read, unless the file has changed since."""
        document, stamp = other.written
        if stamp and stamp != self._stamp and stamp == self._now():
            self.document, self._stamp, self.good, self.diagnostics = document, stamp, True, []

    def now(self) -> RequestsDocument:
        """The current content, read again only if someone else has changed the file; the last good content while it is
        broken."""
        if self._now() == self._stamp:
            return self.document
        other = RequestsFile(self.path)
        other.read()
        return other.document if other.good else self.document

    def keep(self) -> None:
        """While the file is broken, keep its last good content beside it, so that a restart of rorg forgets nothing."""
        spare = self.path.with_name(SPARE)
        if not self.diagnostics:
            spare.unlink(missing_ok=True)
        elif self.good:
            write_atomic(spare, render(self.document))
        elif spare.is_file():
            document, _, _ = _content(spare)
            if document is not None:
                self.document, self.good = document, True

    def _now(self) -> tuple[int, ...] | None:
        """A value that changes with every version of the file; None if it cannot be looked at."""
        try:
            stat = self.path.stat()
        except FileNotFoundError:
            return ()
        except OSError:
            return None
        return stat.st_ino, stat.st_mtime_ns, stat.st_size

    def change(
        self,
        edit: Callable[[RequestsDocument], RequestsDocument],
        notify: bool = True,
        known: Callable[[], None] = lambda: None,
    ) -> RequestsDocument:
        """Apply `edit` to the current content and replace the file. Raises Invalid if the file is broken: a person must
        fix it first, so that their edit is not lost. Without `notify` the caller tells the loop itself: `known` is
        called when the loop may act on the change, if there is one: it is in its place then, and only a loss of power
        can take it back."""
        with locked(self.path.with_name(".requests.lock")):
            self.read()
            if self.diagnostics:
                diagnostic = self.diagnostics[0]
                raise Invalid(
                    f"change {self.path}", f"{diagnostic.where}: {diagnostic.message}", "to fix the file first"
                )
            changed = edit(self.document)
            if changed != self.document:
                self._replace(changed, known)
                if notify:
                    wakeup.notify(self.path.parent)
            return self.document

    def _replace(self, changed: RequestsDocument, known: Callable[[], None]) -> None:
        def placed() -> None:
            self.document, self._stamp = changed, self._now()
            self.written = self.document, self._stamp
            known()

        write_atomic(self.path, render(changed), placed=placed)


def _content(path: Path) -> tuple[RequestsDocument | None, list[Diagnostic], bool]:
    """Return the content (empty without a file), its errors, and whether the file could be read. With any content,
    the robot goes on."""
    try:
        text = read_state(path)
    except FileNotFoundError:
        return RequestsDocument(), [], True
    except OSError as error:
        return None, [Diagnostic(Where(str(path)), f"cannot be read: {error.strerror}", "to fix or move it")], False
    try:
        return *parse(text, str(path)), True
    except Exception as bug:
        return None, [Diagnostic(Where(str(path)), f"cannot be read: {type(bug).__name__}: {bug}", "to fix it")], True
