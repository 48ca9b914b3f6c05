"""Records what happens: lines for people, and the journal."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from rorg.core.changes import changed_items, changed_keys
from rorg.core.decide import Decision
from rorg.core.digest import unreadable
from rorg.core.losses import losses, ready_runs
from rorg.core.masking import Masker
from rorg.core.memory import Memory, Progress
from rorg.core.observed import Observed
from rorg.core.plan import Action
from rorg.core.requests import MOST_TOLD
from rorg.daemon.history import Historian
from rorg.daemon.passages import Passages
from rorg.daemon.ros_events import RosEvents
from rorg.daemon.snapshot import pressure_json
from rorg.daemon.tree import Tree
from rorg.engines.protocol import Engine
from rorg.history.database import Database
from rorg.history.journal import Journal
from rorg.host.shared_memory import Removed
from rorg.model.diagnostics import nearest
from rorg.model.units import counted, format_memory, format_seconds
from rorg.store.requests_file import RequestsFile
from rorg.store.state_dir import StateDir

QUIET_AT_FIRST = ("engine", "pressure")
"""What is not worth a line when the loop begins."""


class Recorder:
    """`say` gets one line for each thing that happened; `wall` gives ISO 8601 in UTC; `clock` monotonic seconds. Both
    lines and journal are without what `masker` hides."""

    def __init__(
        self,
        state: StateDir,
        say: Callable[[str], None],
        wall: Callable[[], str],
        clock: Callable[[], float],
        engine: Engine,
        masker: Masker,
    ) -> None:
        self.masker = masker
        self.say, self.wall, self.clock, self.engine = say, wall, clock, engine
        self.history = Database(state.journal, wall)
        self.journal = Journal(self.history)
        self.historian = Historian(self.history, wall, masker)
        self._passages = Passages(lambda kind, message, **more: self.journal.append(wall(), kind, message, **more))
        self._ros = RosEvents(self.event)
        self._said: dict[str, Any] = {}
        self._ready: dict[str, str] = {}
        """Service -> the run that requests relied on at the last pass."""
        self._progress: Mapping[str, Progress] = {}
        """Of the last pass."""
        self._observed: Observed | None = None
        """By the last pass."""
        self._warned: frozenset[str] = frozenset()
        """Warnings of the tree in force: those of before are not told again with every change of it."""
        self._lock = threading.Lock()

    def begin(self, memory: Memory) -> None:
        """What the last rorg has told of is not told again, and what was ready under it can be lost."""
        self._progress = memory.progress
        self._ready = {name: step.relied_on for name, step in memory.progress.items() if step.relied_on}
        for name, step in memory.progress.items():
            known = {"crashes": step.crashes, "stalled": step.stalled, "update": step.update.failed}
            self._said.update({f"{word} {name}": value for word, value in known.items()})

    def event(self, kind: str, message: str, person: bool = False, **more: Any) -> None:
        """`person`: a person did it."""
        with self._lock:
            self.tell(message)
            masker = self.masker.of(more.get("service"))
            self.journal.append(self.wall(), kind, masker.text(message), person, **masker.value(more))

    def tell(self, message: str) -> None:
        with contextlib.suppress(OSError, ValueError):  # nobody reads our output any more
            self.say(self.masker.text(message))

    def purged(self, node: str) -> None:
        """A ROS node's registration was taken out of the master."""
        text = f"the stale registration of the ROS node {node} was taken out of the master"
        self.event("ros-purged", text, node=node)

    def parameters_set(self, service: str, master: str, names: list[str]) -> None:
        """ROS parameters of a service were set at its master; values are not told."""
        text = f"{counted(len(names), 'ROS parameter')} of {service} set at {master}: {', '.join(names)}"
        self.event("parameters-set", text, service=service, master=master, parameters=names)

    def shm_purged(self, removed: Removed) -> None:
        """What dead ROS 2 participants left was removed."""
        files = f"{counted(removed.files, 'file')} ({format_memory(removed.size)})"
        self.event(
            "shm-purged",
            f"{files} of dead ROS 2 participants removed from shared memory",
            files=removed.files,
            bytes=removed.size,
        )

    def outcome(self, action: Action, error: str, seconds: float) -> None:
        text = f"{action}: " + (f"failed: {error}" if error else f"done in {seconds * 1000:.0f} ms")
        self.event(
            "failed" if error else "done",
            text,
            verb=action.verb,
            service=action.service,
            container=action.container[:12],
            reason=action.reason,
            fields=list(action.fields),
            error=error,
            seconds=round(seconds, 4),
        )

    def report(self, decision: Decision, tree: Tree, requests: RequestsFile) -> None:
        """Says what is new since the last pass, nothing twice."""
        self._when_new(
            "tree",
            (tuple(map(str, (*tree.errors, *tree.warnings))), tree.desired.catalog.fingerprint, tree.revision),
            self._tree,
            tree,
        )
        self.when_new("git trust", tree.refusal, "git-refused", tree.refusal or "git trusts the manifests again")
        self._unknown(decision)
        self._when_new("requests", tuple(map(str, requests.diagnostics)), self._requests, requests)
        observed = decision.situation.observed
        self._when_new("engine", (observed.complete, observed.error), self._engine, observed)
        self._strange(observed)
        for violation in decision.violations:
            self._when_new(f"violation {violation}", True, lambda v: self.event("violation", f"bug: {v}"), violation)
        before, self._progress = self._progress, decision.memory.progress
        self._forget(before.keys() - self._progress.keys() if before is not self._progress else ())
        for name in changed_keys(before, self._progress):
            step = self._progress[name]
            self._when_new(f"crashes {name}", step.crashes, self._crashed, (name, step, decision))
            self._when_new(f"stalled {name}", step.stalled, self._stalled, (name, step))
            self._when_new(f"update {name}", step.update.failed, self._updated, (name, step))
        told = pressure_json(decision)
        self._when_new(
            "pressure", (tuple(told["measures"]), tuple(told["shed"]), told["helpless"]), self._pressure, decision
        )
        self._when_new("holds", tuple(decision.holds), self._holds, decision)
        self._devices(decision)
        self._ros.tell(decision)
        self._when_new("suspended", bool(decision.situation.suspended), self._suspended, decision)
        if observed.complete:
            self._passages.note(decision)
        if observed.complete and tree.loaded:
            self._lost(decision)
        self._when_new("withheld", decision.situation.withheld, self._withheld, decision)

    def _forget(self, gone: Iterable[str]) -> None:
        """A service that is declared again after it was gone begins anew, and has not crashed yet."""
        for name in gone:
            for word in ("crashes", "stalled", "update", "device"):
                self._said.pop(f"{word} {name}", None)

    def when_new(self, key: str, value: Any, kind: str, message: str) -> None:
        """An event, unless the last one of this key said the same."""
        self._when_new(key, value, lambda _: self.event(kind, message), None)

    def _when_new(self, key: str, value: Any, tell: Callable[[Any], None], subject: Any) -> None:
        first = key not in self._said
        if first or self._said[key] != value:
            self._said[key] = value
            if not first or key in ("tree", "requests", "engine") or (value and key not in QUIET_AT_FIRST):
                tell(subject)

    def _tree(self, tree: Tree) -> None:
        if tree.source is not None and (news := tree.source.take_news()):
            self.event("git-commit", f"{news} {'is refused' if tree.errors else 'comes into force'}")
        if tree.errors:
            for error in tree.errors:
                self.event("manifest-error", str(error))
            kept = "the last good manifests stay in force" if tree.loaded else "nothing is in force yet"
            self.event("tree-refused", f"manifests refused: {counted(len(tree.errors), 'error')}; {kept}")
        elif tree.loaded:
            count = sum(not s.meta for s in tree.desired.catalog.services.values())
            self.event(
                "tree-accepted",
                f"manifests in force: {counted(count, 'service')}"
                + (f", revision {tree.revision}" if tree.revision else ""),
            )
            warnings = list(map(str, tree.warnings))
            for warning in warnings:
                if warning not in self._warned:
                    self.event("manifest-warning", warning)
            self._warned = frozenset(warnings)
            self._ignored(tree)

    def _ignored(self, tree: Tree) -> None:
        """Options that somebody declared and the engine ignores are not passed over in silence."""
        users: dict[str, int] = {}
        for service in tree.desired.catalog.services.values():
            declared = frozenset(service.spec or {}) - frozenset(service.defaults)
            for option in self.engine.capabilities.ignored(declared):
                users[option] = users.get(option, 0) + 1
        if users:
            found = ", ".join(f"{option} ({counted(count, 'service')})" for option, count in sorted(users.items()))
            self.event("options-ignored", f"the {self.engine.name} engine ignores options: {found}")

    def _requests(self, requests: RequestsFile) -> None:
        for error in requests.diagnostics:
            self.event("requests-refused", f"{error}; the last good requests stay in force")

    def _unknown(self, decision: Decision) -> None:
        """Names in the requests file that mean nothing: whoever edits it by hand hears of a typing error."""
        catalog = decision.situation.desired.catalog
        known = {*catalog.services, *catalog.groups}
        found = tuple((str(r.where), r.id, s) for r in decision.settled.requests for s in r.services if s not in known)
        self._when_new("unknown", found, self._unknown_names, (found, known))

    def _unknown_names(self, what: Any) -> None:
        found, known = what
        for where, id, name in found[:MOST_TOLD]:
            told = f"{where}: request '{id}' names '{name}', which is not declared"
            self.event("unknown-service", f"{told}; {nearest(name, known)}")
        if len(found) > MOST_TOLD:
            self.event("unknown-service", f"{len(found) - MOST_TOLD} more names in requests are not declared")

    def _engine(self, observed: Any) -> None:
        if observed.complete:
            self.event("engine", f"engine answers: {counted(len(observed.containers), 'container')} of this robot")
        elif observed.error:
            self.event("engine-lost", observed.error)

    def _strange(self, observed: Observed) -> None:
        """Containers of ours of which something cannot be read; looked for only where any are others than before."""
        before, self._observed = self._observed, observed
        if before is observed:
            return
        changed = changed_items(before.containers if before else (), observed.containers)
        there = {c.id for c in observed.containers} if changed else set()
        for container in changed:
            if container.id not in there:
                self._said.pop(f"container {container.id}", None)
            elif why := unreadable(container):
                text = f"the container {container.name} ({container.id[:12]}): {why}"
                self.when_new(f"container {container.id}", why, "container-unreadable", text)

    def _crashed(self, what: Any) -> None:
        name, step, decision = what
        service = decision.situation.desired.catalog.services.get(name)
        kind = "driver " if service and service.driver else ""
        self.event(
            "crashed",
            f"{kind}{name} {step.error or step.update.failed} (unexpected exit {step.crashes})",
            service=name,
            crashes=step.crashes,
        )

    def _stalled(self, what: Any) -> None:
        name, step = what
        again = format_seconds(max(0.0, step.retry_at - self.clock()))
        self.event(
            "stalled" if step.stalled else "recovered",
            f"{name} is stalled: {step.error}; next try in {again}" if step.stalled else f"{name} is no longer stalled",
            service=name,
        )

    def _updated(self, what: Any) -> None:
        name, step = what
        if step.update.failed:
            self.event(
                "update-failed",
                f"the change of {name} failed: {step.update.failed}; back to the container "
                f"before, until it is changed again, or `rorg retry {name}`",
                service=name,
                error=step.update.failed,
            )

    def _pressure(self, decision: Decision) -> None:
        told = pressure_json(decision)
        what = ", ".join([*told["measures"], *(f"{name} ceased" for name in told["shed"])])
        text = f"pressure: {told['reason']}" + (f"; in force: {what}" if what else "")
        text += "; nothing that rorg runs would help" * (told["helpless"] and not what)
        self.event("pressure", text if what or told["helpless"] else "pressure is over", **told)

    def _holds(self, decision: Decision) -> None:
        held = "; ".join(f"{name} {why}" for name, why in decision.holds.items())
        self.event("holds", held or "no service is held", services=list(decision.holds))

    def _devices(self, decision: Decision) -> None:
        for name in decision.situation.desired.drivers:
            why = decision.situation.unplugged.get(name, "")
            self._when_new(f"device {name}", why, self._plugged, (name, why))

    def _plugged(self, what: tuple[str, str]) -> None:
        """That a device of a driver has gone, or is back."""
        name, why = what
        text = f"{name}: {why or 'all of its devices are there'}"
        self.event("unplugged" if why else "plugged", text, service=name)

    def _withheld(self, decision: Decision) -> None:
        found = decision.situation.withheld
        by_reason: dict[str, list[str]] = {}
        for name, why in found.items():
            by_reason.setdefault(why, []).append(name)
        lines = "; ".join(f"{', '.join(names)} (not declared, but kept: {why})" for why, names in by_reason.items())
        self.event(
            "withheld",
            f"removals withheld: {lines}; `rorg apply` shows and confirms them" if found else "no removal is withheld",
            services=list(found),
        )

    def _suspended(self, decision: Decision) -> None:
        self.event("suspended", decision.situation.suspended or "no longer suspended")

    def _lost(self, decision: Decision) -> None:
        """Tells those who hold requests what they cannot rely on any more."""
        before, self._ready = self._ready, ready_runs(decision)
        for loss in losses(before, self._ready, decision):
            self.event(
                "lost",
                f"{loss.service} is lost to {', '.join(loss.requests)}: {loss.reason}",
                service=loss.service,
                cause=loss.cause,
                incarnation=loss.incarnation,
                requests=list(loss.requests),
            )
