"""The tables of the history, with as few indices as are needed for speed, since each is written with every entry. Each
step leads from one `user_version` to the next; a released step is never changed."""

from __future__ import annotations

import contextlib
import sqlite3
from functools import cache

from rorg.history.damage import Damaged

STEPS = (
    """
CREATE TABLE entry (
  seq INTEGER PRIMARY KEY, at TEXT NOT NULL, kind TEXT NOT NULL, message TEXT NOT NULL,
  person INTEGER NOT NULL, more TEXT NOT NULL
);
CREATE INDEX entry_kind ON entry (kind);
CREATE INDEX entry_people ON entry (seq) WHERE person;
CREATE TABLE about (service TEXT, seq INTEGER, PRIMARY KEY (service, seq)) WITHOUT ROWID;
CREATE TABLE revision (
  number INTEGER PRIMARY KEY, at TEXT NOT NULL, fingerprint TEXT NOT NULL, git TEXT NOT NULL, author TEXT NOT NULL,
  subject TEXT NOT NULL, dirty INTEGER NOT NULL, robot TEXT NOT NULL, standing TEXT NOT NULL, reason TEXT NOT NULL,
  settled_at TEXT NOT NULL, plan TEXT NOT NULL, errors TEXT NOT NULL
);
CREATE TABLE made (
  service TEXT, first INTEGER, last INTEGER, digest TEXT NOT NULL, image TEXT NOT NULL, image_id TEXT NOT NULL,
  edition TEXT NOT NULL, PRIMARY KEY (service, first)
) WITHOUT ROWID;
CREATE TABLE spec (digest TEXT PRIMARY KEY, declared TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE run (service TEXT PRIMARY KEY, text TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE asked (number INTEGER PRIMARY KEY, at TEXT NOT NULL, content TEXT NOT NULL);
CREATE INDEX asked_at ON asked (at);
CREATE TABLE asked_text (content TEXT PRIMARY KEY, text TEXT NOT NULL) WITHOUT ROWID;
""",
    """
CREATE TABLE usage (
  hour TEXT, service TEXT, run TEXT, seconds REAL NOT NULL, cpu REAL NOT NULL, byte_seconds REAL NOT NULL,
  peak INTEGER NOT NULL, PRIMARY KEY (hour, service, run)
) WITHOUT ROWID;
""",
    """
ALTER TABLE revision ADD COLUMN proven_at TEXT NOT NULL DEFAULT '';
CREATE TABLE verdict (
  service TEXT, edition TEXT, code TEXT NOT NULL, reason TEXT NOT NULL, at TEXT NOT NULL, PRIMARY KEY (service, edition)
) WITHOUT ROWID;
UPDATE revision SET proven_at = settled_at WHERE standing = 'good';
INSERT OR IGNORE INTO verdict SELECT service, edition, 'proven', '', proven_at FROM made JOIN revision
  ON standing = 'good' AND number >= first AND (last IS NULL OR number <= last);
""",
    """
ALTER TABLE entry ADD COLUMN checksum INTEGER;
""",
    """
ALTER TABLE verdict ADD COLUMN proven_at TEXT NOT NULL DEFAULT '';
UPDATE verdict SET proven_at = at WHERE code = 'proven';
""",
)
"""entry: the journal; `about` names the services of an entry. made: what each service was made from in the revisions
first..last (NULL: up to the last one). verdict: what is known of each edition of a service; `proven_at` is empty if it
was never well. run: the memory that survives a restart. asked: the requests file since a time. usage: what each run of
a service used in a minute, or in ten, or in an hour: `hour` is a time up to that place. checksum: of the other columns
of an entry, because SQLite's file has none; NULL if an older rorg wrote it."""


def migrate(connection: sqlite3.Connection) -> bool:
    """Bring a file to this version of the tables; whether it had none. Raises Damaged if it has other ones."""
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if version > len(STEPS):
        raise Damaged(f"it is of version {version}, which a newer rorg wrote")
    try:
        for number, step in enumerate(STEPS[max(0, version) :], version + 1):
            connection.executescript(f"BEGIN IMMEDIATE;{step}PRAGMA user_version = {number};COMMIT;")
    except sqlite3.OperationalError as error:
        if error.sqlite_errorcode == sqlite3.SQLITE_ERROR:  # the disk and other processes cause other errors
            raise Damaged(str(error)) from error
        raise
    if not _columns(connection) >= _right_columns():
        raise Damaged("its tables are not rorg's")
    return bool(version == 0)


def _columns(connection: sqlite3.Connection) -> frozenset[tuple[str, ...]]:
    """Tables and indices with their columns: other versions of SQLite write their texts in other ways."""
    sql = "SELECT m.type, m.name, c.name, c.type FROM sqlite_master m LEFT JOIN pragma_table_info(m.name) c"
    return frozenset(connection.execute(sql))


@cache
def _right_columns() -> frozenset[tuple[str, ...]]:
    with contextlib.closing(sqlite3.connect(":memory:")) as connection:
        for step in STEPS:
            connection.executescript(step)
        return _columns(connection)
