"""Revisions: the states of the manifests that were applied or refused, with what each service was made from."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, Protocol

from rorg.errors import Invalid
from rorg.history.damage import check_types
from rorg.history.database import Change, Database
from rorg.model.units import parse_time

UNDER_WAY = ("applying", "baking")
"""Standings that are not final."""
NUMBER = re.compile(r"[0-9]{1,6}")
"""Numbers as in `rorg history`. git never abbreviates a commit to fewer than seven digits by default."""
MOST = 999_999
LONGEST_PLAN = 1 << 18
"""Characters of a plan that are kept."""
COLUMNS = (
    "number, at, fingerprint, git, author, subject, dirty, robot, standing, reason, settled_at, proven_at, plan, errors"
)
FIELDS = tuple(COLUMNS.replace("git", "commit").split(", "))
"""`commit` is a keyword of SQL."""


@dataclass(frozen=True, slots=True)
class Made:
    """The material that a service is made from."""

    digest: str
    """Of its rendered spec, as in the label rorg.io/spec."""
    declared: str
    """The rendered spec as in the label rorg.io/declared: only hashes of environment values."""
    image: str = ""
    """The reference."""
    image_id: str = ""
    """The engine's id of the image; empty if it was never known."""
    edition: str = ""


@dataclass(frozen=True, slots=True)
class Revision:
    """One state of the manifests. Times are ISO 8601 in UTC."""

    number: int
    """1, 2, ...; 0 before it is written."""
    at: str
    """When it was begun."""
    fingerprint: str
    """Of the tree's content."""
    commit: str = ""
    """As git names it in full; empty outside of a repository."""
    author: str = ""
    subject: str = ""
    """The first line of the commit's message."""
    dirty: bool = False
    """Files differed from the commit."""
    robot: str = ""
    """The robot whose overlay was applied."""
    standing: str = "applying"
    reason: str = ""
    settled_at: str = ""
    proven_at: str = ""
    """When it became good for the first time; empty if it never was."""
    plan: str = ""
    """The canonical text of its first plan."""
    errors: tuple[str, ...] = ()
    """Of a refused one."""
    services: Mapping[str, Made] = field(default_factory=dict)
    """Services with a container. list() leaves them out; get() has them."""


class Span(NamedTuple):
    """The revisions, from the first to the last, in which a service has the same edition; `last` of the one in force is
    unknown yet."""

    first: int
    last: int | None
    edition: str


class Revisions:
    """The table of revisions. The owner of the file begins and settles them, from one thread."""

    def __init__(self, database: Database) -> None:
        self.database = database
        self._lock = threading.Lock()
        self._number = next((revision.number for revision in self.list(1)), 0) if database.wall else 0
        self._services: Mapping[str, Made] | None = None
        """Of the last revision that was not refused."""
        self._generation = database.generation

    # -- writing -----------------------------------------------------------------------------------------------

    def begin(self, revision: Revision) -> Revision:
        """Write a revision with the next number. It supersedes one that is under way, unless it is refused."""
        with self._lock:
            number = self._number + 1
            new = replace(revision, number=number, plan=revision.plan[:LONGEST_PLAN])
            if self._generation != self.database.generation:
                self._services, self._generation = {}, self.database.generation
            before = self._last_services()
            if new.standing != "refused":
                self._services = new.services
            self._number = number
        self.database.write(_begin(new, before))
        return new

    def settle(self, number: int, standing: str, reason: str, at: str) -> None:
        """Record a new standing."""
        sql = (
            "UPDATE revision SET standing = ?, reason = ?, settled_at = ?,"
            " proven_at = CASE WHEN proven_at = '' THEN ? ELSE proven_at END WHERE number = ?"
        )
        proven_at = at if standing == "good" else ""
        self.database.write([(sql, [(standing, reason, at, proven_at, number)])])

    def revise(self, number: int, reason: str) -> None:
        """Record a new reason for its standing."""
        self.database.write([("UPDATE revision SET reason = ? WHERE number = ?", [(reason, number)])])

    def note_images(self, number: int, images: Mapping[str, str]) -> None:
        """Record the engine's image ids of services, once they are known."""
        rows = [(image, service, number, number) for service, image in images.items()]
        sql = (
            "UPDATE made SET image_id = ?"
            " WHERE service = ? AND image_id = '' AND first <= ? AND (last IS NULL OR last >= ?)"
        )
        with self._lock:
            known = dict(self._last_services())
            told = {n: i for n, i in images.items() if n in known and not known[n].image_id}
            self._services = known | {n: replace(known[n], image_id=i) for n, i in told.items()}
        self.database.write([(sql, rows)])

    def _last_services(self) -> Mapping[str, Made]:
        if self._services is None:
            self._services = self._made("last IS NULL", ())
        return self._services

    # -- reading -----------------------------------------------------------------------------------------------

    def get(self, number: int) -> Revision | None:
        """With its services."""
        revisions = self._select("number = ?", (number,), 1)
        if not revisions or revisions[0].standing == "refused":
            return revisions[0] if revisions else None
        return replace(
            revisions[0], services=self._made("first <= ? AND (last IS NULL OR last >= ?)", (number, number))
        )

    def last(self, standing: str = "") -> Revision | None:
        """The last one, or the last one with a standing, with its services."""
        revisions = self._select("? IN ('', standing)", (standing,), 1)
        return self.get(revisions[0].number) if revisions else None

    def oldest(self) -> Revision | None:
        """The first one on record that was not refused, with its services."""
        sql = "SELECT min(number) FROM revision WHERE standing <> 'refused'"
        number = next((n for (n,) in self.database.rows(sql)), None)
        return self.get(number) if number else None

    def in_force(self) -> Revision | None:
        """The last one that was not refused, with its services."""
        revisions = self._select("standing <> 'refused'", (), 1)
        return self.get(revisions[0].number) if revisions else None

    def list(self, most: int, before: int = 0) -> Sequence[Revision]:
        """The newest ones first; with `before`, only those older than that number."""
        return self._select("number < ?" if before else "number > ?", (before,), most)

    def of_commit(self, commit: str) -> Revision | None:
        """The last one of a git commit, in full or abbreviated, with its services."""
        revisions = self._select("git LIKE ? AND standing <> 'refused'", (f"{commit}%",), 1)
        revisions = revisions or self._select("git LIKE ?", (f"{commit}%",), 1)
        return self.get(revisions[0].number) if revisions else None

    def spans(self, service: str) -> Sequence[Span]:
        """The editions that a service had, the newest first."""
        sql = "SELECT first, last, edition FROM made WHERE service = ? ORDER BY first DESC"
        return self.database.read(_span, sql, (service,))

    def changed_in(self, service: str, number: int, edition: str) -> int:
        """Return the revision in which a service got this edition, which it has in revision `number`; 0 if that is not
        on record, because the disk was full."""
        first = 0
        for span in self.spans(service):
            if span.first <= number and not first:
                if span.edition != edition:
                    return 0
                first = span.first
            elif first and (span.last, span.edition) == (first - 1, edition):
                first = span.first
        return first

    def _select(self, condition: str, args: tuple[Any, ...], most: int) -> Sequence[Revision]:
        sql = f"SELECT {COLUMNS} FROM revision WHERE {condition} ORDER BY number DESC LIMIT ?"
        return self.database.read(_revision, sql, (*args, most))

    def _made(self, condition: str, args: tuple[Any, ...]) -> dict[str, Made]:
        sql = (
            "SELECT service, digest, coalesce(declared, ''), image, image_id, edition FROM made LEFT JOIN spec"
            f" USING (digest) WHERE {condition} ORDER BY service"
        )
        return dict(self.database.read(_material, sql, args))


def _begin(new: Revision, before: Mapping[str, Made]) -> Change:
    """Of the services, only those are written that are made differently than before."""
    row = (new.number, new.at, new.fingerprint, new.commit, new.author, new.subject, int(new.dirty), new.robot)
    more = (new.standing, new.reason, new.settled_at, new.proven_at, new.plan, json.dumps(new.errors))
    insert = f"INSERT OR REPLACE INTO revision ({COLUMNS}) VALUES (?,?,?,?,?,?,?,?,?,?,?,?,?,?)", [(*row, *more)]
    if new.standing == "refused":
        return [insert]
    gone = [name for name, made in before.items() if new.services.get(name) != made]
    made = [(name, of) for name, of in new.services.items() if before.get(name) != of]
    return [
        (
            f"UPDATE revision SET standing = 'superseded', reason = ?, settled_at = ? WHERE standing IN {UNDER_WAY}",
            [(f"revision {new.number} replaced it before it was proven", new.at)],
        ),
        (
            "UPDATE made SET last = ? WHERE service = ? AND last IS NULL",
            [(new.number - 1, name) for name in gone],
        ),
        (
            "INSERT OR REPLACE INTO made (service, first, digest, image, image_id, edition) VALUES (?,?,?,?,?,?)",
            [(name, new.number, of.digest, of.image, of.image_id, of.edition) for name, of in made],
        ),
        (
            "INSERT OR IGNORE INTO spec (digest, declared) VALUES (?, ?)",
            sorted({(of.digest, of.declared) for _, of in made}),
        ),
        insert,
    ]


def _revision(*row: Any) -> Revision:
    """Raises ValueError and TypeError if it is damaged."""
    check_types(row, int, *[str] * 5, int, *[str] * 7)
    fields = dict(zip(FIELDS, row, strict=True))
    errors = json.loads(fields["errors"])
    check_types(errors, *[str] * len(errors))
    if not 0 < fields["number"] <= MOST:
        raise ValueError(f"the number of a revision is {fields['number']}")
    for time in filter(None, (fields["at"], fields["settled_at"], fields["proven_at"])):
        parse_time(time)
    return Revision(**{**fields, "dirty": bool(fields["dirty"]), "errors": tuple(errors)})


def _material(name: str, *values: str) -> tuple[str, Made]:
    check_types(values, *[str] * len(values))
    return name, Made(*values)


def _span(first: int, last: int | None, edition: str) -> Span:
    check_types((first, last or 0, edition), int, int, str)
    return Span(first, last, edition)


class Numbered(Protocol):
    """Has revisions by number."""

    def get(self, number: int) -> Revision | None:
        """With its services."""


def parse(text: str, revisions: Numbered) -> Revision | str:
    """The revision of that number, if there is one; otherwise the text, for git: a commit, a tag, a branch, HEAD~2."""
    revision = revisions.get(int(text)) if text.isascii() and NUMBER.fullmatch(text) else None
    return revision or text


def for_git(text: str, revisions: Numbered) -> str:
    """The same for git: of a revision its commit. Raises Invalid if no commit has that revision."""
    revision = parse(text, revisions)
    if not isinstance(revision, Revision):
        return revision
    if revision.dirty or not revision.commit:
        why = "its manifests were not all committed" if revision.commit else "its tree was in no repository"
        raise Invalid(
            f"read the manifests of revision {revision.number}", why, f"`rorg history show {revision.number}`"
        )
    return revision.commit
