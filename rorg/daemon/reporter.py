"""Finds what is new since the last pass and has the recorder write it down, each thing once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rorg.core.changes import changed_items, changed_keys
from rorg.core.decide import Decision
from rorg.core.digest import unreadable
from rorg.core.idle import risks
from rorg.core.memory import Memory, Progress
from rorg.core.observed import Observed
from rorg.core.probes_in_force import fits
from rorg.core.requests import MOST_TOLD
from rorg.core.ros_graph import Takeover
from rorg.core.service_events import NONE, losses, ready_runs, state_changes
from rorg.core.wanted import Wanted
from rorg.daemon.recorder import Recorder
from rorg.daemon.snapshot import pressure_json
from rorg.daemon.tree import Tree
from rorg.engines.protocol import Engine
from rorg.model.diagnostics import nearest
from rorg.model.units import counted, format_left
from rorg.store.requests_file import RequestsFile

OFTEN = 8
"""Exits in a row, after which only each one that doubles their number gets a line."""


class Reporter:
    """Used by the loop alone; `clock` gives monotonic seconds. `memory` is what the previous rorg left: what was ready
    under it can be lost."""

    def __init__(self, recorder: Recorder, engine: Engine, clock: Callable[[], float], memory: Memory) -> None:
        self.recorder, self.engine, self.clock = recorder, engine, clock
        self.event, self.when_new, self.is_news = recorder.event, recorder.when_new, recorder.is_news
        self._ready = {name: step.relied_on for name, step in memory.progress.items() if step.relied_on}
        """Service -> the run that requests relied on at the last pass."""
        self._progress: Mapping[str, Progress] = memory.progress
        """As of the last pass, like the following ones."""
        self._observed: Observed | None = None
        self._warned: frozenset[str] = frozenset()
        """Warnings of the tree in force, which are not repeated with its next change."""
        self._states: dict[str, str] | None = None
        """Service -> its state in the journal; None before anything is known."""
        self._risks: set[tuple[str, str]] = set()
        """(service, code) of the risks of pausing that were reported: they come and go with who else is wanted."""
        self._wanted: Wanted = {}
        self._takeovers: frozenset[Takeover] = frozenset()

    def report(self, decision: Decision, tree: Tree, requests: RequestsFile) -> None:
        """Record what is new since the last pass."""
        observed = decision.situation.observed
        shown = tuple(map(str, (*tree.errors, *tree.warnings)))
        if self.is_news("tree", (shown, tree.desired.catalog.fingerprint, tree.revision)):
            self._tree(tree)
        self._git(tree)
        self._unknown(decision)
        if self.is_news("requests", tuple(map(str, requests.diagnostics))):
            for error in requests.diagnostics:
                self.event("requests-refused", f"{error}; the last good requests stay in force")
        if self.is_news("engine", (observed.complete, observed.error)):
            self._engine(observed)
        self._unreadable(observed)
        for violation in decision.violations:
            self.when_new(f"violation {violation}", True, "violation", f"bug: {violation}")
        self._services(decision)
        self._pressure(decision)
        if self.is_news("holds", tuple(decision.holds)):
            held = "; ".join(f"{name} {why}" for name, why in decision.holds.items())
            self.event("holds", held or "no service is held", services=list(decision.holds))
        for name in decision.situation.desired.drivers:
            why = decision.situation.unplugged.get(name, "")
            if self.is_news(f"device {name}", why):
                text = f"{name}: {why or 'all of its devices are there'}"
                self.event("unplugged" if why else "plugged", text, service=name)
        self._twice(decision)
        self._ros(decision)
        suspended = decision.situation.suspended
        self.when_new("suspended", bool(suspended), "suspended", suspended or "no longer suspended")
        if observed.complete:
            self._note_states(decision)
        if observed.complete and tree.loaded:
            self._lost(decision)
        if self.is_news("withheld", decision.situation.withheld):
            self._withheld(decision.situation.withheld)

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
            revision = f", revision {tree.revision}" if tree.revision else ""
            self.event("tree-accepted", f"manifests in force: {counted(count, 'service')}{revision}")
            warnings = list(map(str, tree.warnings))
            for warning in warnings:
                if warning not in self._warned:
                    self.event("manifest-warning", warning)
            self._warned = frozenset(warnings)
            self._ignored(tree)

    def _git(self, tree: Tree) -> None:
        self.when_new("git trust", tree.refusal, "git-refused", tree.refusal or "git trusts the manifests again")
        while tree.source and not tree.source.events.empty():
            self.when_new(*tree.source.events.get())

    def _ignored(self, tree: Tree) -> None:
        """Report the options that manifests declare and the engine ignores, once, although the manifests change."""
        users: dict[str, int] = {}
        for service in tree.desired.catalog.services.values():
            declared = frozenset(service.options) - frozenset(service.defaults)
            for option in self.engine.capabilities.ignored(declared):
                users[option] = users.get(option, 0) + 1
        if users:
            options = ", ".join(f"{option} ({counted(count, 'service')})" for option, count in sorted(users.items()))
            told = f"the {self.engine.name} engine ignores options: {options}"
            self.when_new("options ignored", options, "options-ignored", told)

    def _unknown(self, decision: Decision) -> None:
        """Report names in the requests file that are not declared, such as typing errors of a person who edits it."""
        catalog = decision.situation.desired.catalog
        known = {*catalog.services, *catalog.groups}
        unknown_names = tuple(
            (str(r.where), r.id, s) for r in decision.settled.requests for s in r.services if s not in known
        )
        if not self.is_news("unknown", unknown_names):
            return
        for where, id, name in unknown_names[:MOST_TOLD]:
            told = f"{where}: request '{id}' names '{name}', which is not declared"
            self.event("unknown-service", f"{told}; {nearest(name, known)}")
        if len(unknown_names) > MOST_TOLD:
            self.event("unknown-service", f"{len(unknown_names) - MOST_TOLD} more names in requests are not declared")

    def _engine(self, observed: Observed) -> None:
        if observed.complete:
            self.event("engine", f"engine answers: {counted(len(observed.containers), 'container')} of this robot")
        elif observed.error:
            self.event("engine-lost", observed.error)

    def _unreadable(self, observed: Observed) -> None:
        """Report containers of ours whose labels cannot be read."""
        before, self._observed = self._observed, observed
        if before is observed:
            return
        went, came = changed_items(before.containers if before else (), observed.containers)
        there = {c.id for c in observed.containers} if went else set()
        self.recorder.forget([f"container {c.id}" for c in went if c.id not in there])
        for container in came:
            if why := unreadable(container):
                text = f"the container {container.name} ({container.id[:12]}): {why}"
                self.when_new(f"container {container.id}", why, "container-unreadable", text)

    def _services(self, decision: Decision) -> None:
        """Crashes, stalls and failed changes."""
        before, self._progress = self._progress, decision.memory.progress
        if before is not self._progress:  # a service that is declared again begins afresh
            gone = before.keys() - self._progress.keys()
            self.recorder.forget(f"{word} {n}" for n in gone for word in ("crashes", "stalled", "update", "device"))
        for name in changed_keys(before, self._progress):
            step, failed = self._progress[name], self._progress[name].update.failed
            often = step.exits >= OFTEN and step.exits.bit_count() == 1
            self.recorder.fold(name, step.exits > OFTEN and not often)
            if self.is_news(f"crashes {name}", step.crashes):
                service = decision.situation.desired.catalog.services.get(name)
                what = f"{'driver ' if service and service.driver else ''}{name} {step.error or failed or 'ended'}"
                text = f"{what} (unexpected exit {step.crashes})"
                self.event("crashed", text, service=name, crashes=step.crashes)
                if often:
                    left = f"the next line is about its {2 * step.exits}th exit in a row"
                    self.recorder.tell(f"{name} goes on like this: {left}, and `rorg events` has all of them")
            if self.is_news(f"stalled {name}", step.stalled):
                until = step.retry_at - self.clock()
                again = f"next try {format_left(until)}" if until > 0 else "trying again now"
                text = f"stalled: {step.error or 'no effect'}; {again}" if step.stalled else "no longer stalled"
                about = {"service": name, **({"error": step.error} if step.stalled else {})}
                self.event("stalled" if step.stalled else "recovered", f"{name} is {text}", False, **about)
            if self.is_news(f"update {name}", failed) and failed:
                situation, more = decision.situation, f"change it again, or `rorg retry {name}`"
                # Without another container only a file or a probe changed, and no container comes back.
                if not all(fits(c, name, situation.desired) for c in situation.observed.of(name)):
                    more = f"back to the previous container, until it is changed again, or `rorg retry {name}`"
                text = f"the change of {name} failed: {failed}; {more}"
                self.event("update-failed", text, service=name, error=failed)

    def _pressure(self, decision: Decision) -> None:
        told = pressure_json(decision)
        if not self.is_news("pressure", (tuple(told["measures"]), tuple(told["shed"]), told["helpless"])):
            return
        what = ", ".join([*told["measures"], *(f"{name} ceased" for name in told["shed"])])
        text = f"pressure: {told['reason']}" + (f"; in force: {what}" if what else "")
        text += "; nothing that rorg runs would help" * (told["helpless"] and not what)
        self.event("pressure", text if what or told["helpless"] else "pressure is over", **told)

    def _twice(self, decision: Decision) -> None:
        """Report services that run on another machine too, which only a person's `rorg take` makes possible."""
        containers = decision.situation.observed.by_service()
        for name, machine in decision.situation.peers.disputed.items():
            here = any(c.alive for c in containers.get(name, ()))
            if self.is_news(f"twice {name}", here and machine) and here:
                text = f"{name} runs here and on {machine}, whose manifests give it to {machine}; bring them up to date"
                self.event("runs-twice", text, service=name, machine=machine)

    def _ros(self, decision: Decision) -> None:
        """Report what the ROS 1 graph shows. Only passes over all services bring another graph; what is wanted may
        change without one."""
        situation = decision.situation
        before, self._wanted = self._wanted, situation.wanted
        changed = decision.planned.whole or before is not situation.wanted
        if not changed or not (situation.ros or self._takeovers):
            return
        for service in situation.desired.catalog.services.values():
            for risk in risks(situation, service):
                if (service.name, risk.code) not in self._risks:
                    self._risks.add((service.name, risk.code))
                    text = f"pausing {service.name} is not safe: {risk.message}"
                    self.event("pause-risk", text, service=service.name, cause=risk.code)
        takeovers = frozenset(takeover for graph in situation.ros.values() for takeover in graph.takeovers)
        for takeover in sorted(takeovers - self._takeovers, key=str):
            services = [takeover.former, takeover.service]
            self.event("ros-node-taken-over", str(takeover), node=takeover.node, services=services)
        self._takeovers = takeovers

    def _note_states(self, decision: Decision) -> None:
        """Write the states that services come into to the journal, without a line for people."""
        first = self._states is None
        states = self._states = self._states or {}
        changes = state_changes(states, decision)
        states.update({p.service: p.state for p in changes})
        if first and changes:  # one entry for all, since nothing has changed
            message = f"found {counted(len(changes), 'service')} with a container"
            self._write("found", message, services=[p.service for p in changes], states=dict(states))
            return
        for p in changes:
            more: dict[str, Any] = {"requests": list(p.requests)} if p.requests else {}
            more |= {"failed": True} if p.failed else {}
            self._write("state", str(p), service=p.service, state=p.state, reason=p.reason, **more)
            if p.state == NONE:
                del states[p.service]

    def _write(self, kind: str, message: str, **more: Any) -> None:
        self.recorder.journal.append(self.recorder.wall(), kind, message, **more)

    def _withheld(self, removals: Mapping[str, str]) -> None:
        by_reason: dict[str, list[str]] = {}
        for name, why in removals.items():
            by_reason.setdefault(why, []).append(name)
        lines = "; ".join(f"{', '.join(names)} (not declared, but kept: {why})" for why, names in by_reason.items())
        text = (
            f"removals withheld: {lines}; `rorg apply` shows and confirms them"
            if removals
            else "no removal is withheld"
        )
        self.event("withheld", text, services=list(removals))

    def _lost(self, decision: Decision) -> None:
        """Tell the holders of requests what they can no longer rely on."""
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
