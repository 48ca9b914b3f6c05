"""Writes what passes change into the history: revisions with their standing, the memory that survives a restart, and
the requests of meta-services. A pass that changes none of these writes nothing."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

from rorg.core.changes import changed_keys, differing
from rorg.core.decide import Decision
from rorg.core.desired import Desired
from rorg.core.digest import canonical, declared_fields
from rorg.core.masking import Masker
from rorg.core.memory import Due, Memory, Progress
from rorg.core.plan import Plan
from rorg.core.standing import FAILED, GOOD, Standing, standing
from rorg.core.update import Update
from rorg.daemon.saved_memory import remembered, saved_progress
from rorg.daemon.tree import Tree
from rorg.history.database import Database
from rorg.history.evidence import FAILS, PROVEN, Evidence, Verdict
from rorg.history.meta_requests import Asked
from rorg.history.revisions import UNDER_WAY, Made, Revision, Revisions
from rorg.history.runs import Runs
from rorg.model.catalog import Catalog, Request
from rorg.model.causes import Cause
from rorg.model.codes import BLOCKED, NO_IMAGE


class Historian:
    """`wall` gives ISO 8601 in UTC. What `masker` hides is not written. `failed` gets the number of a revision that
    failed, why, and whether it had been good before."""

    def __init__(
        self, database: Database, wall: Callable[[], str], masker: Masker, failed: Callable[[int, str, bool], None]
    ) -> None:
        self.wall, self.masker, self.failed = wall, masker, failed
        self.revisions, self.runs, self.asked = Revisions(database), Runs(database), Asked(database)
        self.evidence = Evidence(database)
        self.standing: Standing | None = None
        """The standing of the manifests in force, as of the last pass; None before it is known."""
        self._revision: Revision | None = None
        """The revision in force."""
        self._changed: frozenset[str] = frozenset()
        """Its services that differ from the last good revision."""
        self._imageless: set[str] = set()
        """Its services whose image id is not known yet."""
        self._looked = False
        """Whether the revision that was in force before this rorg began has been looked up."""
        self._refused: Revision | None = None
        """The last refused state of the manifests, while they are refused."""
        self._failing: frozenset[str] = frozenset()
        """Its services that are known to have failed."""
        self._seen: tuple[object, ...] = ()
        """The tree of the last pass."""
        self._images: Mapping[str, str] = {}
        self._progress: Mapping[str, Progress] = {}
        self._restarts: Mapping[str, Due] = {}
        self._stale: set[str] = set()
        """Services whose newest state the disk has not taken yet."""
        self._requests: tuple[Request, ...] | None = None

    def remembered(self, now: float, boot: str) -> Memory:
        """What the previous rorg left for this one: see saved_memory.py."""
        memory = remembered(self.runs.read(), now, boot)
        self._progress, self._restarts = memory.progress, memory.restarts
        return memory

    def note(self, decision: Decision, memory: Memory, tree: Tree, boot: str) -> None:
        """After a pass. `memory` is the one that it hands on; `boot` is the id of this boot."""
        self._note_runs(memory, boot)
        settled = decision.settled.requests
        if settled is not self._requests:
            self._requests = settled
            self.asked.note(self.wall(), _of_meta(settled, decision.situation.desired.catalog))
        if tree.errors:
            self._refuse(tree)
        elif tree.loaded and decision.situation.observed.complete:
            self._refused = None
            self._note_revision(decision, memory, tree)
        elif tree.loaded and self._is_new(tree):
            self.standing = None  # that of earlier manifests says nothing about these

    # -- what outlives the loop --------------------------------------------------------------------------------

    def _note_runs(self, memory: Memory, boot: str) -> None:
        progress, due = memory.progress, memory.restarts
        gone = self._progress.keys() - progress.keys() if progress is not self._progress else set()
        changed = changed_keys(self._progress, progress) | self._stale | differing(self._restarts, due)
        changed &= progress.keys()
        self._note_verdicts(v for name in changed for v in verdicts(name, progress[name].update))
        self._progress, self._restarts = progress, due
        if changed or gone:
            saved = {name: saved_progress(progress[name], due.get(name), boot) for name in changed}
            texts = {name: self.masker.json(json.dumps(known)) for name, known in saved.items()}
            self._stale = set() if self.runs.write(texts, gone) else changed

    def _note_verdicts(self, news: Iterable[Verdict]) -> None:
        self.evidence.note((replace(v, reason=self.masker.text(v.reason)) for v in news), self.wall())

    # -- revisions ---------------------------------------------------------------------------------------------

    def _refuse(self, tree: Tree) -> None:
        """Record a refused tree, once for each set of errors."""
        errors = tuple(self.masker.text(str(e)) for e in tree.errors)
        revision = Revision(
            number=0,
            at=self.wall(),
            fingerprint="",
            **_of_commit(tree),
            standing="refused",
            reason=errors[0],
            errors=errors,
        )
        last = self._refused or self.revisions.last()
        if not (last and last.standing == "refused" and (last.errors, last.commit) == (errors, revision.commit)):
            last = self.revisions.begin(replace(revision, settled_at=revision.at))
        self._refused = last

    def _note_revision(self, decision: Decision, memory: Memory, tree: Tree) -> None:
        if tree.overtaken:
            return  # the next pass has read what belongs to that commit
        if self._is_new(tree):
            self._seen = (tree.desired, tree.commit)
            self._begin(decision.plan, memory, tree)
        revision = self._revision
        if revision is None:
            return
        self._note_images(decision, revision.number)
        before = Standing(revision.standing, revision.reason)
        self.standing = verdict = standing(decision, before, self._changed)
        if verdict.code != before.code:
            self._revision = self._settle(revision, verdict, verdict.failing)
        elif verdict.failing - self._failing and verdict != before:
            self._revision = self._revise(revision, verdict, verdict.failing)
        self._failing |= verdict.failing
        if verdict.failing:
            # No run shows that these editions fail, because nothing of them runs.
            held_up = decision.plan.reasons(NO_IMAGE, BLOCKED)
            editions = decision.situation.desired.editions
            self._note_verdicts(Verdict(n, editions[n], FAILS, why[-1]) for n, why in held_up.items() if n in editions)

    def _is_new(self, tree: Tree) -> bool:
        """Return whether the tree was read after the revision in force was noted."""
        seen = (tree.desired, tree.commit)
        return len(self._seen) != len(seen) or any(a is not b for a, b in zip(self._seen, seen, strict=True))

    def _note_images(self, decision: Decision, number: int) -> None:
        """Record the images of containers that are as declared, as they appear."""
        there, digests = decision.situation.observed.by_service(), decision.situation.desired.digests
        images = {
            name: container.image
            for name in self._imageless
            for container in there.get(name, ())
            if container.image and container.digest == digests.get(name)
        }
        if images:
            self.revisions.note_images(number, images)
            self._imageless -= images.keys()

    def _begin(self, plan: Plan, memory: Memory, tree: Tree) -> None:
        """Record a state of the manifests, unless it is the one in force."""
        if not self._looked:
            self._revision, self._looked = self.revisions.in_force(), True
        last = self._revision
        revision = Revision(
            number=0,
            at=self.wall(),
            fingerprint=tree.desired.catalog.fingerprint,
            **_of_commit(tree),
            robot=tree.robot,
        )
        if last is None or _identity(last) != _identity(revision):
            self._settle_failed(last, memory)
            services = made(tree.desired, last.services if last else {}, self.masker)
            self._failing = frozenset()
            self._revision = self.revisions.begin(
                replace(revision, plan=self.masker.text(plan.text()), services=services)
            )
        known = self._revision.services if self._revision else {}
        self._imageless = {name for name, made in known.items() if not made.image_id}
        self._changed = self._changed_since_good()

    def _changed_since_good(self) -> frozenset[str]:
        """The services of the revision in force that differ from the last good one, or from the oldest one on record if
        none was good."""
        revision = self._revision
        base = self.revisions.last(GOOD) or self.revisions.oldest()
        if revision is None or base is None or base.number >= revision.number:
            return frozenset()
        then = base.services
        return frozenset(n for n, m in revision.services.items() if n not in then or then[n].edition != m.edition)

    def _settle_failed(self, last: Revision | None, memory: Memory) -> None:
        """Record a failure that is found in the same pass as the next revision."""
        if last is None or last.standing not in UNDER_WAY:
            return
        failed = {
            name: why
            for name, made in last.services.items()
            if (why := memory.of(name).update.quarantined.get(made.edition))
        }
        if failed:
            reason = "; ".join(f"{name}: {why}" for name, why in failed.items())
            self._settle(last, Standing(FAILED, reason), failed)

    def _settle(self, revision: Revision, verdict: Standing, failing: Iterable[str]) -> Revision:
        """Record a new standing. The revision with it."""
        now, reason = self.wall(), self._reason(revision, verdict, failing)
        self.revisions.settle(revision.number, verdict.code, self.masker.text(reason), now)
        if verdict.code == FAILED:
            self.failed(revision.number, reason, bool(revision.proven_at))
        proven_at = revision.proven_at or (now if verdict.code == GOOD else "")
        return replace(revision, standing=verdict.code, reason=reason, proven_at=proven_at)

    def _revise(self, revision: Revision, verdict: Standing, failing: Iterable[str]) -> Revision:
        """Record that more services fail. The revision with them."""
        reason = self._reason(revision, verdict, failing)
        self.revisions.revise(revision.number, self.masker.text(reason))
        return replace(revision, reason=reason)

    def _reason(self, revision: Revision, verdict: Standing, failing: Iterable[str]) -> str:
        """The reason of a standing, with the revisions to blame for services that an earlier one changed."""
        blamed: dict[int, list[str]] = {}
        for name in failing:
            edition = revision.services[name].edition if name in revision.services else ""
            blamed.setdefault(self.revisions.changed_in(name, revision.number, edition), []).append(name)
        origins = [
            f"{Cause(tuple(sorted(names)), '').who} last changed in revision {number}"
            for number, names in sorted(blamed.items())
            if number not in (0, revision.number)
        ]
        return f"{verdict.reason} ({'; '.join(origins)})" if origins else verdict.reason


def _of_commit(tree: Tree) -> dict[str, Any]:
    """The fields of a Revision that git knows."""
    commit = tree.commit
    return {name: getattr(commit, name) for name in ("commit", "author", "subject", "dirty")} if commit else {}


def _identity(revision: Revision) -> tuple[object, ...]:
    return revision.fingerprint, revision.commit, revision.dirty, revision.robot


def made(desired: Desired, before: Mapping[str, Made], masker: Masker) -> dict[str, Made]:
    """The Material of each service with a container. `before`: the same of the previous revision."""
    materials = {}
    for name, service in desired.catalog.services.items():
        if service.spec is None:
            continue
        digest, known = desired.digests[name], before.get(name)
        if known is not None and (known.digest, known.edition) == (digest, desired.editions[name]):
            materials[name] = known
            continue
        declared = masker.json(canonical(declared_fields(service.spec, service.secrets)))
        materials[name] = Made(digest, declared, str(service.spec.get("image", "")), edition=desired.editions[name])
    return materials


def verdicts(name: str, update: Update) -> list[Verdict]:
    """What is known of the editions of a service: which one has stayed well, and which ones fail."""
    failures = [Verdict(name, edition, FAILS, why) for edition, why in update.failures.items()]
    proven = update.baked and update.baked not in update.failures
    return [*failures, *([Verdict(name, update.baked, PROVEN)] if proven else [])]


def _of_meta(requests: Iterable[Request], catalog: Catalog) -> list[Request]:
    services = catalog.services
    return [r for r in requests if r.requester in services and services[r.requester].meta and not r.standing]
