"""What reads input that somebody else wrote, as functions of bytes. Any input is read, or refused by a documented
error, with its place if it is a file. Another exception is a defect, and so is more time or memory than fuzzing.py
allows.

`make fuzz-guided` searches for such inputs (guided_fuzzing.py); test_guided_cases.py tries those again that it found.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path

from histories import wall
from import_inputs import (
    LAUNCH2_WORDS,
    LAUNCH_WORDS,
    LAUNCHES,
    LAUNCHES2,
    PROJECT,
    PROJECT_WORDS,
    UNIT_WORDS,
    UNITS,
    is_whole,
)
from mutated_trees import REQUESTS, a_tree, is_planned, placeless

from rorg.core.desired import desire
from rorg.daemon.saved_memory import remembered
from rorg.errors import RorgError
from rorg.history import queries
from rorg.history.database import Database
from rorg.history.journal import Filter, Journal
from rorg.history.request_log import RequestLog
from rorg.history.revisions import Revisions
from rorg.history.runs import Runs
from rorg.history.usage import UsageTable
from rorg.host.contents import Contents
from rorg.manifest.documents import UNEXPECTED
from rorg.manifest.files import Reader
from rorg.manifest.load import load
from rorg.model.diagnostics import Diagnostic
from rorg.store.requests_parser import parse, render
from rorg.tools.compose.load import load as load_project
from rorg.tools.importing.compose import from_compose
from rorg.tools.importing.roslaunch import from_roslaunch
from rorg.tools.importing.systemd import from_systemd

MOST_INPUT = 1 << 16
"""Bytes of an input."""


class Target:
    """One reader. `folder` is its own."""

    words: tuple[str, ...] = ()
    """Pieces that its format knows."""
    json = False
    """Whether its inputs are JSON, and not YAML."""

    every = 1
    """What takes long is done with every so many inputs."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.tries = folder, 0

    def due(self) -> bool:
        """Whether to do what takes long with this input."""
        self.tries += 1
        return not self.tries % self.every

    def seeds(self) -> list[bytes]:
        """Inputs to begin with."""
        raise NotImplementedError

    def attempt(self, data: bytes) -> None:
        """Raises for a defect."""
        raise NotImplementedError

    def close(self) -> None:
        """End what runs."""


def have_places(errors: tuple[Diagnostic, ...]) -> None:
    for error in errors:
        assert error.where.file, error
        assert error.where.line > 0, error
        assert error.where.column > 0, error
        assert UNEXPECTED not in error.message, error


class Files(Target):
    """A reader of several files. The first line of an input names one of them, the rest is what that says."""

    files: dict[str, str]

    def seeds(self) -> list[bytes]:
        return [f"{name}\n{text}".encode() for name, text in self.files.items()]

    def attempt(self, data: bytes) -> None:
        head, _, content = data.partition(b"\n")
        name = head.decode(errors="replace")
        if name not in self.files:
            return
        (self.folder / name).write_bytes(content)
        try:
            self.read()
        finally:
            (self.folder / name).write_text(self.files[name])

    def read(self) -> None:
        raise NotImplementedError


class Manifests(Files):
    """A tree that says everything that a manifest can say."""

    def __init__(self, folder: Path) -> None:
        super().__init__(a_tree(folder))
        paths = [folder / "services/rich.yaml", *(folder / "images").glob("*.yaml")]
        paths += [*(folder / "policies").glob("*.yaml"), *(folder / "profiles").glob("*.yaml")]
        paths += [folder / "images/image/Dockerfile", folder / "services/some.env"]
        self.files = {str(p.relative_to(folder)): p.read_text() for p in paths}

    def read(self) -> None:
        found = load(self.folder)
        assert found.catalog is not None or found.errors
        have_places(tuple(found.errors))
        if found.catalog is not None:
            desire(found.catalog, str(self.folder), Contents().of(found.catalog, self.folder))
            if self.due():
                is_planned(found.catalog)


class Requests(Target):
    """The requests file."""

    def seeds(self) -> list[bytes]:
        return [REQUESTS.encode()]

    def attempt(self, data: bytes) -> None:
        document, diagnostics = parse(data.decode("utf-8", errors="surrogateescape"), "requests.yaml")
        assert document is not None or diagnostics
        have_places(tuple(diagnostics))
        if document is not None:
            assert placeless(parse(render(document), "requests.yaml")[0]) == placeless(document)


class Imports(Files):
    """Files of a project that is imported."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        for name, text in self.files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text)

    def whole(self, imported) -> None:
        have_places(imported.errors)
        is_whole(imported, self.folder, 0 if self.due() else 1)


class Compose(Imports):
    files, words = PROJECT, PROJECT_WORDS

    def read(self) -> None:
        loaded = load_project([self.folder], {"HOME": "/home/x"}, Reader(self.folder), profiles=["*"])
        assert (loaded.project is None) == bool(loaded.errors)
        have_places(tuple(loaded.errors))
        if loaded.project is not None:
            self.whole(from_compose(loaded.project, self.folder / "manifests", self.folder, lambda _: None))


class Launch(Imports):
    files, words = LAUNCHES, LAUNCH_WORDS

    def read(self) -> None:
        self.whole(from_roslaunch(self.folder / "nav.launch", Reader(self.folder), {"map": "m"}))


class Launch2(Imports):
    files, words = LAUNCHES2, LAUNCH2_WORDS

    def read(self) -> None:
        self.whole(from_roslaunch(self.folder / "nav.launch.xml", Reader(self.folder), {"map": "m"}, ros=2))


class Units(Imports):
    files, words = UNITS, UNIT_WORDS

    def read(self) -> None:
        read = Reader(self.folder)
        try:
            texts = {self.folder / name: read(self.folder / name) for name in UNITS}
        except OSError:
            return
        self.whole(from_systemd(texts, "", self.folder / "manifests"))


ROWS = {
    "revision": (1, "2026-01-01T00:00:00.000000Z", "f", "abc", "a", "s", 0, "r", "good", "", "2026", "{}", "[]", ""),
    "verdict": ("cam", "e", "proven", "", "2026-01-01T00:00:00.000000Z", "2026-01-01T00:00:00.000000Z"),
    "made": ("cam", 1, None, "d", "image", "id", "e"),
    "spec": ("d", '{"image": "x"}'),
    "run": ("cam", "{}"),
    "asked": (1, "2026-01-01T00:00:00.000000Z", "c"),
    "asked_text": ("c", REQUESTS),
    "usage": ("2026-01-01T00:00", "cam", "r", 1.0, 1.0, 1.0, 1),
}
"""A row of each table but those of the entries."""
SPAN = "2000-01-01T00:00:00.000000Z", "2100-01-01T00:00:00.000000Z"
CHANGES = "changes"
"""The first line of an input that is a list of changes of the journal's tables, in JSON."""


class History(Target):
    """The journal: any bytes as its file, or a sound file with anything in its tables."""

    json = True
    words = ("SQLite format 3\0", CHANGES, '["entry", "more", "', "null", "1e400", '{"service": ', '{"services": [')

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.sound, self.path = folder / "sound.db", folder / "journal.db"
        database = Database(self.sound, wall)
        journal = Journal(database)
        for kind, more in (
            ("state", {"service": "cam", "state": "running"}),
            ("request", {"services": ["cam"], "id": "look", "requester": "x"}),
            ("done", {"service": "cam", "verb": "start"}),
        ):
            journal.append(wall(), kind, "what happened", person=kind == "request", **more)
        database.close()
        with contextlib.closing(sqlite3.connect(self.sound)) as file:
            for table, row in ROWS.items():
                file.execute(f"INSERT INTO {table} VALUES ({','.join('?' * len(row))})", row)
            file.commit()
            file.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            self.tables = {
                name: [row[1] for row in file.execute(f"PRAGMA table_info({name})")]
                for (name,) in file.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
                if not name.startswith("sqlite_")
            }

    def seeds(self) -> list[bytes]:
        changes = [[table, column, value] for table, cs in self.tables.items() for column in cs for value in (1, "{}")]
        return [self.sound.read_bytes(), *(f"{CHANGES}\n{json.dumps([c])}".encode() for c in changes)]

    def attempt(self, data: bytes) -> None:
        for path in self.folder.glob("journal*"):
            path.unlink()
        head, _, rest = data.partition(b"\n")
        if head == CHANGES.encode():
            shutil.copyfile(self.sound, self.path)
            if not self.change(rest):
                return
        else:
            self.path.write_bytes(data)
        self.read()

    def change(self, text: bytes) -> bool:
        try:
            changes = json.loads(text)
            with contextlib.closing(sqlite3.connect(self.path, isolation_level=None)) as file:
                for table, column, value in changes:
                    if column in self.tables[table]:
                        file.execute(f"UPDATE OR REPLACE {table} SET {column} = ?", (value,))
        except (ValueError, TypeError, KeyError, RecursionError, sqlite3.Error, OverflowError):
            return False
        return True

    def read(self) -> None:
        database = Database(self.path, wall)
        try:
            journal, revisions = Journal(database), Revisions(database)
            for found in (Filter(), Filter(services=frozenset({"cam"})), Filter(text="a%"), Filter(since="2026")):
                json.dumps(journal.select(found, 100, newest=True))
            queries.listed(revisions, 100)
            json.dumps(queries.timeline(journal, "cam", *SPAN))
            for _ in queries.records(journal, revisions):
                pass
            with contextlib.suppress(RorgError):
                RequestLog(journal).between(*SPAN)
            UsageTable(database).since("")
            remembered(Runs(database).read(), 0.0, "")
            journal.append(wall(), "state", "one more", service="cam")
            assert journal.select(Filter(), 1, newest=True)[0]["message"] == "one more"
        finally:
            database.close()


TARGETS: dict[str, Callable[[Path], Target]] = {
    "manifests": Manifests,
    "requests": Requests,
    "compose": Compose,
    "launch": Launch,
    "launch2": Launch2,
    "units": Units,
    "journal": History,
}


def make(name: str, folder: Path) -> Target:
    """The target with a name, in a folder of its own."""
    return TARGETS[name](folder)
