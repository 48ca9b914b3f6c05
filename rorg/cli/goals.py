"""Finds the earlier state of the manifests that is meant, for `rorg rollback` and `restore`."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from textwrap import shorten
from typing import Any

from rorg_client import Error as ClientError

from rorg.cli.context import Context
from rorg.cli.output import missing
from rorg.cli.records import records_of
from rorg.errors import Missing, Refused, RorgError
from rorg.history.revisions import Revision, parse
from rorg.host.git import commit_of
from rorg.host.git_edit import SHORT, subject_of
from rorg.host.git_process import git_command
from rorg.model.units import parse_since, stamp

SHORTEST = 7
"""Least digits of a commit in a name."""
NO_TIME = re.compile(r"[0-9]+|[0-9a-f]{7,}")
"""A number of `rorg history` or a commit, even if it could be read as a time."""
EARLIER = re.compile(r"^(Roll back( \S+)? to \S+( \([0-9a-f]+\))?: )+")
"""What a rollback writes before the subject of the commit that it returns to: of many in a row, the last is enough."""
KNOWN = 1000
"""Revisions that are searched, the newest first."""
NAMED = 5
"""Revisions that an error names."""
LONGEST = 110
"""Characters of the doubt about each."""


@dataclass(frozen=True, slots=True)
class Goal:
    """A state to return to."""

    commit: str
    """The full hash."""
    name: str
    """Its name: a number of `rorg history`, or what git understands."""
    subject: str
    doubt: str = ""
    """Why it is not known to work; empty if it is, or if nothing is on record of it."""

    @property
    def title(self) -> str:
        """As in 12 (abc1234): subject"""
        short = self.commit[:SHORT]
        same = NO_TIME.fullmatch(self.name) and len(self.name) >= SHORTEST and self.commit.startswith(self.name)
        return f"{short if same else f'{self.name} ({short})'}: {EARLIER.sub('', self.subject)}"


Differs = Callable[[Goal], bool]
"""Whether a return to a goal would change a file."""


class Known:
    """The revisions on record, read only if one is needed: git finds its own names. With a `service`, its states alone
    count."""

    def __init__(self, context: Context, service: str = "") -> None:
        self.context, self.service = context, service

    @cached_property
    def revisions(self) -> list[Revision]:
        """The newest first. Raises Unreachable if the files may not be read and no rorg runs."""
        with records_of(self.context) as records:
            rows = records.listed(KNOWN)
        return [Revision(**{**row, "errors": tuple(row["errors"])}) for row in rows]

    def get(self, number: int) -> Revision | None:
        return next((r for r in self.revisions if r.number == number), None)

    def at(self, time: str) -> Revision | None:
        """The revision that was in force at a time (ISO 8601 in UTC)."""
        return next((r for r in self.revisions if r.at <= time and r.standing != "refused"), None)

    def committed(self, revision: Revision, root: Path) -> bool:
        """Whether its commit contains everything of it. If files differed from the commit, the fingerprint of the
        manifests decides."""
        from rorg.daemon.commit_tree import load_at
        from rorg.daemon.tree import Tree

        if not (revision.commit and commit_of(root, revision.commit)):
            return False
        if not revision.dirty:
            return True
        with contextlib.suppress(RorgError):
            engine = (self.context.live() or {}).get("engine_name") or self.context.engine_name
            tree = Tree(root, engine=engine, host=revision.robot)
            return load_at(tree, revision.commit).catalog.fingerprint == revision.fingerprint
        return False

    @cached_property
    def earlier(self) -> dict[int, dict[str, Any]]:
        """The revisions that a rollback may return to, by number, the newest first: see EarlierView of the API."""
        with records_of(self.context) as records:
            return {row["number"]: row for row in records.earlier(self.service)}

    def doubt(self, revision: Revision) -> str:
        """Why a revision is not known to work; empty if it is."""
        if revision.standing == "failed" and not (self.service and revision.number in self.earlier):
            return f"revision {revision.number} failed: {revision.reason}"
        other = "" if revision.standing == "good" else f"it is {revision.standing}"
        doubt = self.earlier.get(revision.number, {}).get("doubt", other)
        return f"revision {revision.number} is not known to work: {doubt}" if doubt else ""

    def doubt_about(self, commit: str) -> str:
        """The same of the last revision of a commit, if one is on record."""
        with contextlib.suppress(RorgError, ClientError):  # git finds a commit also if the history may not be read
            found = next((r for r in self.revisions if r.commit == commit and not r.dirty), None)
            return self.doubt(found) if found else ""
        return ""

    def proven_before(self, root: Path, differs: Differs) -> Revision:
        """The last revision before the current one that can be trusted, has a complete commit, and `differs` in what
        the rollback changes. Raises Refused, and Invalid for an unknown service."""
        from rorg.api.manifest_texts import manifests_of

        if self.service and not self.earlier:
            declared = [name for kind, name in manifests_of(root) if kind == "Service"]
            if self.service not in declared:
                raise missing("service", self.service, declared)
        doubts: dict[int, str] = {}
        for revision in (r for number in self.earlier if (r := self.get(number))):
            doubt = self.earlier[revision.number]["doubt"]
            if not doubt and not self.committed(revision, root):
                doubt = "git does not have all of it"
            if doubt:
                doubts[revision.number] = doubt
                continue
            if self.service and not differs(goal(revision, self, root)):
                why = (
                    f"only other files than its manifest and mounts differ from {revision.number}, where it was proven"
                )
                raise Refused(f"roll {self.service} back", why, f"`rorg rollback {revision.number}` for all services")
            return revision
        raise self._no_goal(doubts, root)

    def _no_goal(self, doubts: Mapping[int, str], root: Path) -> Refused:
        """The error if no revision can be trusted, with the doubt about each."""
        what, service = f"roll {self.service} back" if self.service else "roll back", f" --service {self.service}"
        log = git_command(root, "log")
        remedy = f"`rorg rollback REV{service * bool(self.service)}`, with a REV of `rorg history` or `{log}`"
        unchanged = [set(row.get("unchanged", ())) for row in self.earlier.values()]
        same = sorted(set.intersection(*unchanged)) if unchanged else [self.service] * bool(self.service)
        if same:
            names = ", ".join(same)
            return Refused(what, f"nothing earlier differs in {names}", f"to fix {names}, or try {remedy}")
        if not doubts:
            return Refused(what, "no earlier revision is on record", remedy)
        lines = [f"  {number}: {shorten(doubt, LONGEST, placeholder=' ...')}" for number, doubt in doubts.items()]
        more = [f"  and {len(lines) - NAMED} earlier"] if len(lines) > NAMED else []
        return Refused(what, "\n".join(["no earlier revision is proven", *lines[:NAMED], *more, ""]), remedy)


def goal_of(text: str, revisions: Known, root: Path, differs: Differs = lambda _: True) -> Goal:
    """The goal that a REV names; by default the last good one that `differs`. Raises Missing and Refused."""
    revision = parse(text, revisions) if text else revisions.proven_before(root, differs)
    if isinstance(revision, Revision):
        return goal(revision, revisions, root)
    commit = commit_of(root, revision)
    if not commit:
        why = "no such number in `rorg history`, and git knows no such commit, tag or branch"
        remedy = f"`rorg history`, or `{git_command(root, 'log')}`"
        raise Missing(f"find the revision '{text}'", why, remedy)
    return Goal(commit, revision, subject_of(root, commit), revisions.doubt_about(commit))


def goal(revision: Revision, revisions: Known, root: Path) -> Goal:
    """The commit of a revision. Raises Refused if git does not have all of it."""
    if not revisions.committed(revision, root):
        commit = revision.commit[:SHORT]
        why = f"the repository no longer contains {commit}" if commit else "it was in no repository"
        if revision.dirty:
            why = f"it was {commit} with uncommitted changes"
        raise Refused(f"go back to revision {revision.number}", why, "another revision of `rorg history`")
    return Goal(revision.commit, str(revision.number), revision.subject, revisions.doubt(revision))


def moment_of(text: str, revisions: Known, root: Path, now: float) -> tuple[str, Goal]:
    """(ISO 8601 in UTC, the state then) of a time, or of a REV: when that was proven good, or when it began. `now` in
    seconds since the epoch. Raises Missing and Refused."""
    if not NO_TIME.fullmatch(text):
        with contextlib.suppress(ValueError):
            seconds = parse_since(text, now)
            moment = stamp(seconds)
            if seconds > now:
                raise Refused(f"restore {text}", f"{moment} is in the future", "a time such as 10m (ago)")
            revision = revisions.at(moment)
            if revision is None:
                raise Refused(f"restore {text}", f"nothing is on record of {moment}", "`rorg history`")
            return moment, goal(revision, revisions, root)
    wanted, meant = goal_of(text, revisions, root), parse(text, revisions)
    of_it = (r for r in revisions.revisions if r.commit == wanted.commit and not r.dirty)
    then = meant if isinstance(meant, Revision) else next(of_it, None)
    if then is None:
        raise Refused(f"restore {text}", f"{wanted.title} was never in force here", "`rorg rollback` with it")
    return then.settled_at or then.at, wanted
