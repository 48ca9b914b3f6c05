"""Finds the earlier state of the manifests that is meant, and commits a return to it, for `rorg rollback` and
`restore`."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from rorg_client import Error as ClientError

from rorg.cli.apply import READY, bring_about, taken
from rorg.cli.context import Context
from rorg.cli.differences import Differences, differences
from rorg.cli.output import note
from rorg.cli.records import records_of
from rorg.errors import Missing, Refused, RorgError
from rorg.history.revisions import Revision, parse
from rorg.host.git import commit_of
from rorg.host.git_edit import SHORT, Restoring, changed, subject_of, top_of, unknown
from rorg.model.catalog import Catalog
from rorg.model.codes import CONFIRM
from rorg.model.units import parse_since, stamp

SHORTEST = 7
"""Least digits of a commit in a name."""
NO_TIME = re.compile(r"[0-9]+|[0-9a-f]{7,}")
"""A number of `rorg history` or a commit, even if it could be read as a time."""
EARLIER = re.compile(r"^(Roll back( \S+)? to \S+( \([0-9a-f]+\))?: )+")
"""What a rollback writes before the subject of the commit that it returns to: of many in a row, the last is enough."""
Agreed = Callable[[dict[str, Any] | None, Differences], None]
"""Shows the plan and its owner, and asks. Raises Refused."""
NAMED = 10
"""Files that an error names."""
KNOWN = 1000
"""Revisions that are searched, the newest first."""


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


class Known:
    """The revisions on record, read only if one is needed: git finds its own names."""

    def __init__(self, context: Context) -> None:
        self.context = context

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
    def earlier(self) -> dict[int, str]:
        """The revisions that a rollback may return to, by number, the newest first, each with the doubt about it."""
        with records_of(self.context) as records:
            return {row["number"]: row["doubt"] for row in records.earlier()}

    def doubt(self, revision: Revision) -> str:
        """Why a revision is not known to work; empty if it is."""
        if revision.standing == "failed":
            return f"revision {revision.number} failed: {revision.reason}"
        doubt = self.earlier.get(revision.number, "" if revision.standing == "good" else f"it is {revision.standing}")
        return f"revision {revision.number} is not known to work: {doubt}" if doubt else ""

    def doubt_about(self, commit: str) -> str:
        """The same of the last revision of a commit, if one is on record."""
        with contextlib.suppress(RorgError, ClientError):  # git finds a commit also if the history may not be read
            found = next((r for r in self.revisions if r.commit == commit and not r.dirty), None)
            return self.doubt(found) if found else ""
        return ""

    def proven_before(self, root: Path) -> Revision:
        """The last revision before the current one that can be trusted and has a complete commit. Raises Refused."""
        known = [r for number in self.earlier if (r := self.get(number))]
        trusted = (r for r in known if not self.earlier[r.number])
        found = next((r for r in trusted if self.committed(r, root)), None)
        if found is None:
            doubts = [f"revision {r.number}: {self.earlier[r.number] or 'git does not have all of it'}" for r in known]
            why = "; ".join(["no earlier revision is proven", *doubts[:NAMED]])
            raise Refused("roll back", why, "`rorg rollback REV`, with a REV of `rorg history` or `git log`")
        return found


def goal_of(text: str, revisions: Known, root: Path) -> Goal:
    """The goal that a REV names; by default the last good one. Raises Missing and Refused."""
    revision = parse(text, revisions) if text else revisions.proven_before(root)
    if isinstance(revision, Revision):
        return goal(revision, revisions, root)
    commit = commit_of(root, revision)
    if not commit:
        why = "no such number in `rorg history`, and git knows no such commit, tag or branch"
        raise Missing(f"find the revision '{text}'", why, "`rorg history`, or `git log`")
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
            moment = stamp(parse_since(text, now))
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


def restoring(root: Path, robot: str, goal: Goal, service: str) -> Restoring:
    """The commit that would return the manifests directory and the sources of its images, or the manifest of one
    service and its part of this robot's overlay. Raises Refused, and Invalid if the earlier manifests have errors."""
    from rorg.daemon.commit_tree import load_at
    from rorg.daemon.tree import Tree
    from rorg.manifest.load import load

    top = top_of(root)
    past = load_at(Tree(root, host=robot), goal.commit).catalog
    if service:
        files = _manifest(root, past, service, goal)
        overlay = [root / "robots" / robot / os.path.relpath(path, root) for path in files if robot]
        places, of = [*files, *overlay], f" {service}"
    else:
        now = load(root, robot=robot).catalog
        places, of = [root, *_contexts(past), *(_contexts(now) if now else [])], ""
    return Restoring(top, goal.commit, _below(top, places), f"Roll back{of} to {goal.title}")


def _manifest(root: Path, past: Catalog, service: str, goal: Goal) -> list[Path]:
    """The files that declared it then and declare it now."""
    from rorg.api.manifest_texts import manifests_of

    if service not in past.services or not past.services[service].where.file:
        why = f"it was not declared in {goal.title}"
        raise Refused(f"roll {service} back", why, "`rorg rollback REV` for all services")
    manifests = manifests_of(root)
    now, file = manifests.get(("Service", service)), past.services[service].where.file
    others = [s.where.file for s in past.services.values() if s.name != service]
    others += [group.where.file for group in past.groups.values()]
    if file in others or (now and now.text != now.content):
        why = "its file declares other manifests too, which would go back with it"
        raise Refused(f"roll {service} back", why, "`rorg rollback REV` for all services")
    return [root / file, *([now.path] if now else [])]


def _contexts(catalog: Catalog) -> list[Path]:
    return [Path(image.context) for image in catalog.images.values() if image.context]


def _below(top: Path, places: Iterable[Path]) -> tuple[str, ...]:
    """The places inside the repository, without those inside another of them."""
    roots: list[Path] = []
    for place in sorted({Path(os.path.realpath(p)) for p in places}):
        if place.is_relative_to(top) and not any(place.is_relative_to(other) for other in roots):
            roots.append(place)
    return tuple(str(place.relative_to(top)) for place in roots)


def all_committed(root: Path, robot: str) -> None:
    """Raises Refused if a file of the manifests directory has uncommitted changes, or a manifest is unknown to git."""
    from rorg.manifest.documents import tree_files

    top = top_of(root)
    manifests = [os.path.relpath(path, top) for path in tree_files(root, robot)]
    files = [*changed(top, root), *unknown(top, manifests)]
    if files:
        remedy = f"`git -C {top} commit`, or `stash --include-untracked`"
        raise Refused("go back", f"not committed: {_listed(files)}", remedy)


def _listed(files: list[str]) -> str:
    return ", ".join(files[:NAMED]) + (f" and {len(files) - NAMED} more" if len(files) > NAMED else "")


def go_back(
    context: Context,
    root: Path,
    wanted: Restoring,
    agreed: Agreed,
    *,
    command: str,
    doubt: str = "",
    waiting: tuple[bool, float],
    then: Callable[[], None] = lambda: None,
) -> bool:
    """Shows the plan, the files that change and the `doubt` about the goal, and asks (`agreed`). Then commits, calls
    `then`, and carries it out. `waiting`: whether to wait until
    everything is ready, and for how many seconds. False if there was nothing to commit. Raises Refused and NotReady."""
    from rorg.host.person import caller

    if is_copy(context, root):
        note("\n".join(wanted.commands(clone=True)))
        raise Refused("commit here", "rorg follows another repository", "these commands in a clone of that")
    owner = taken(context, command)
    made = wanted.commit(caller(os.environ, os.getuid(), os.getgid()), os.environ)
    shown = differences(context, rev=made) if made else differences(context)
    if made:
        note(f"files that change: {_listed(wanted.files(made))}")
    if doubt:
        note(f"caution: {doubt}")
    agreed(owner, shown)
    if made:
        wanted.take(made)
        note(f"committed {made[:SHORT]}: {wanted.message}")
    differences(context)  # until rorg has read it
    then()
    comparison = differences(context)
    # What waits for a person but was not shown goes on waiting.
    withheld = [n for n in comparison.withheld if n in shown.withheld]
    waitings = [w for w in comparison.plan["waitings"] if w.get("code") != CONFIRM or w["service"] in shown.unconfirmed]
    agreed_to = comparison._replace(withheld=withheld, plan={**comparison.plan, "waitings": waitings})
    wait, timeout = waiting
    bring_about(context, owner, agreed_to, READY if wait else None, timeout)
    return bool(made)


def is_copy(context: Context, root: Path) -> bool:
    """Whether a directory of manifests is the copy of a repository that a running rorg has fetched."""
    return root.is_relative_to(context.state.git.resolve())


def tree_of(context: Context) -> Path:
    """The directory of manifests: that of the running rorg, even if only its socket is known. Raises Refused outside of
    a repository."""
    if context.place.elsewhere:
        context.here("commit in its tree")
    view = context.live() if context.remote and not context.directory else None
    root = (Path(view["tree"]["root"]) if view else context.root).resolve()
    top_of(root)
    return root
