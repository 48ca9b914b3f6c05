"""The state of everything as JSON: published by the loop, or computed by commands if no loop runs."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any

from rorg.core.changes import changed_keys
from rorg.core.decide import Decision
from rorg.core.memory import Progress
from rorg.core.objects import object_views
from rorg.core.observed import Observed
from rorg.core.plan import Action, Plan, Timed
from rorg.core.pressure import MEASURES
from rorg.core.status import Statuses
from rorg.core.wanted import Wanted, wanted_by
from rorg.daemon.tree import Tree
from rorg.model.catalog import Request
from rorg.model.units import stamp
from rorg.store.requests_document import RequestsDocument
from rorg.store.requests_file import RequestsFile


def about_tree(tree: Tree, requests: RequestsFile) -> dict[str, Any]:
    """Which tree is in force, and the errors in it and in the requests file."""
    return {
        "tree": {
            "root": str(tree.root),
            "fingerprint": tree.desired.catalog.fingerprint,
            "revision": tree.revision,
            "robot": tree.robot,
            "git": _git(tree),
            "standing": tree.standing and {"code": tree.standing.code, "reason": tree.standing.reason},
            "errors": [d.as_json() for d in tree.errors],
            "warnings": [d.as_json() for d in tree.warnings],
        },
        "down": down_of(requests.document),
        "requests_errors": [str(d) for d in requests.diagnostics],
    }


def _git(tree: Tree) -> dict[str, Any] | None:
    """The repository that is followed, and its state; or one that git does not trust; otherwise None."""
    if tree.source is not None:
        return tree.source.as_json()
    if not tree.refusal:
        return None
    nothing = dict.fromkeys(("branch", "commit", "fetched_at"), "")
    return {"followed": False, "repository": str(tree.root), **nothing, "error": tree.refusal}


def down_of(document: RequestsDocument) -> str:
    """How far a robot is taken down: going, down, or empty if it is not."""
    return "" if not document.down else "down" if document.down_since else "going"


def snapshot(decision: Decision, about: dict[str, Any]) -> dict[str, Any]:
    """`about` comes first: which rorg this is, on which tree."""
    situation = decision.situation
    return {
        **_of_all(decision, about),
        "plan": decision.plan.as_json(),
        "runs": {n: run_json(p, situation.now) for n, p in decision.memory.progress.items()},
        "services": {n: s.as_json() for n, s in Statuses(situation, decision.plan, decision.holds).items()},
    }


class Snapshots:
    """Writes the same as text, decision after decision. Only services that were looked at since are written again. The
    loop notes its decisions without waiting for a text that another thread writes."""

    def __init__(self) -> None:
        self._noting, self._writing = threading.Lock(), threading.Lock()
        self._decision: Decision | None = None
        """The one that was noted last."""
        self._stale: set[str] | None = None
        """Services that were looked at since the last text; None for all."""
        self._services: dict[str, str] = {}
        self._runs: dict[str, str] = {}
        self._progress: Mapping[str, Progress] = {}
        """What `_runs` was made from."""
        self._timed: set[str] = set()
        """Services whose entry changes with time alone."""
        self._actions: dict[int, tuple[Action, str]] = {}
        """By identity, which is kept because the action is."""

    def note(self, decision: Decision) -> None:
        """Must be called with every decision, even if no text of it is needed."""
        with self._noting:
            before, self._decision = self._decision, decision
            if decision.planned.whole or before is None:
                self._stale = None
            elif self._stale is not None:
                self._stale.update(decision.planned.replanned)
                for was, out in zip(_out(before), _out(decision), strict=True):
                    self._stale.update(n for n in {*was, *out} if was.get(n) != out.get(n))
                old, new = before.situation, decision.situation
                self._stale |= _wanted_anew(old.wanted, new.wanted) | _wanted_anew(old.asked, new.asked)

    def text(self, about: dict[str, Any]) -> str:
        """The text of the decision that was noted last."""
        with self._writing:
            with self._noting:
                decision, stale, self._stale = self._decision, self._stale, set()
            assert decision is not None, "the loop has made a pass"
            parts = {
                "plan": self._plan_text(decision.plan),
                "runs": _joined(self._run_texts(decision)),
                "services": _joined(self._service_texts(decision, stale)),
            }
        return (
            f"{json.dumps(_of_all(decision, about))[:-1]}, "
            + _joined(f"{json.dumps(name)}: {text}" for name, text in parts.items())[1:]
        )

    def _plan_text(self, plan: Plan) -> str:
        before, self._actions = self._actions, {}
        texts = []
        for index, (action, after) in enumerate(plan.linked()):
            known = before.get(id(action)) or (action, json.dumps(action.as_json()))
            self._actions[id(action)] = known
            texts.append(f'{{"index": {index}, "after": {after}, {known[1][1:]}')
        return f'{{"actions": [{", ".join(texts)}], {json.dumps(plan.beside_actions())[1:]}'

    def _run_texts(self, decision: Decision) -> Iterable[str]:
        progress, now = decision.memory.progress, decision.situation.now
        for name in self._progress.keys() - progress.keys():
            self._runs.pop(name)
        for name in changed_keys(self._progress, progress) | (self._timed & progress.keys()):
            step = progress[name]
            self._runs[name] = f"{json.dumps(name)}: {json.dumps(run_json(step, now))}"
            (self._timed.add if any(t.at for t in step.attempts.values()) else self._timed.discard)(name)
        self._progress = progress
        return self._runs.values()

    def _service_texts(self, decision: Decision, stale: set[str] | None) -> Iterable[str]:
        situation = decision.situation
        if stale is not None and not situation.withheld:
            containers = situation.observed.by_service()
            runs = ((n, p) for n, p in situation.memory.progress.items() if p.running_since is not None)
            # Time alone makes them late, or ends their trial.
            stale.update(n for n, p in runs if not p.ready or len(containers.get(n, ())) > 1)
            stale.update(situation.peers.remotes, situation.peers.unknown)
            stale.update(w.service for w in decision.plan.waitings if isinstance(w.reason, Timed))
        else:
            self._services, stale = {}, None
        statuses = Statuses(situation, decision.plan, decision.holds)
        for name in statuses if stale is None else sorted(filter(statuses.__contains__, stale)):
            self._services[name] = f"{json.dumps(name)}: {json.dumps(statuses[name].as_json())}"
        return self._services.values()


def _out(decision: Decision) -> tuple[Mapping[str, Any], ...]:
    """What is shown of services that are held or preempted: the reasons, the rivals, and who asked for them."""
    situation = decision.situation
    return decision.holds, situation.preempted, situation.rivals, situation.asked


def _wanted_anew(was: Wanted, now: Wanted) -> set[str]:
    """Return the services whose chain of reasons, up to a root, may be another one than before."""
    if was is now:
        return set()
    changed = {n for n in {*was, *now} if was.get(n) != now.get(n)}
    return changed | wanted_by(now, changed)


def _joined(texts: Iterable[str]) -> str:
    return "{" + ", ".join(texts) + "}"


def _of_all(decision: Decision, about: dict[str, Any]) -> dict[str, Any]:
    """Everything that is not about a single service."""
    situation = decision.situation
    requests = (*situation.desired.catalog.requests, *decision.settled.requests)
    return {
        **about,
        "engine": engine_json(situation.observed),
        "suspended": situation.suspended,
        "withheld": dict(situation.withheld),
        "requests": [request_json(r) for r in requests],
        "restarts": sorted(situation.restarts),
        "pressure": pressure_json(decision),
        "objects": object_views(situation, decision.plan),
        "in_flight": {n: f.action.verb for n, f in decision.memory.in_flight.items()},
    }


def engine_json(observed: Observed) -> dict[str, Any]:
    """Whether the engine answers, as EngineView."""
    silence = observed.silence
    return {
        "complete": observed.complete,
        "error": observed.error,
        "address": silence.engine if silence else "",
        "silent_since": stamp(silence.since) if silence else "",
    }


def run_json(step: Progress, now: float) -> dict[str, Any]:
    """`attempts` are times of the machine's monotonic clock; only those after `now`."""
    update = step.update
    more = {
        "edition": update.edition,
        "quarantined": dict(update.quarantined),
        "rejected": update.rejected,
        "spared": update.spared,
        "crashing": dict(update.crashing),
        "drawn": update.drawn,
        "proven": update.proven,
        "baked": update.baked,
        "well": update.well,
        "last_good": asdict(update.last_good) if update.last_good else {},
        "loaded": update.run,
        "stopped_before": list(step.stopped[:-1]),
        "content": dict(update.content),
        "reads": dict(update.begun or {}),
        "attempts": {verb: [t.at, t.error] for verb, t in step.attempts.items() if t.at > now},
    }
    return {
        "run": step.counted_on.run,
        "needs": dict(step.counted_on.needs),
        "stopped": step.stopped[-1] if step.stopped else "",
        **{k: v for k, v in more.items() if v},
    }


def request_json(request: Request) -> dict[str, Any]:
    """A request as the API shows it."""
    names = ("id", "requester", "services", "reason", "incarnation", "standing", "priority", "ttl")
    return {**{name: getattr(request, name) for name in names}, "services": list(request.services)}


def pressure_json(decision: Decision) -> dict[str, Any]:
    """Measures in force, mildest first, and the services that were shed; and the budget."""
    state, budget = decision.memory.pressure, decision.situation.desired.catalog.policy.budget
    return {
        "reason": state.reason,
        "measures": [m for m in MEASURES if state.in_force(m)],
        "helpless": state.helpless,
        "shed": {s.service: s.reason for s in state.shed},
        "budget": {"cpu": budget.cpu, "memory": budget.memory} if budget else None,
    }
