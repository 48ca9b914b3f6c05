"""How everything is, as JSON: what the loop publishes, and what commands compute where no loop runs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from rorg.core.decide import Decision
from rorg.core.memory import Attempt, Memory, Progress
from rorg.core.pressure import MEASURES
from rorg.core.propagation import CountedOn
from rorg.core.status import statuses
from rorg.core.update import Update
from rorg.daemon.tree import Tree
from rorg.model.catalog import Request
from rorg.store.requests_file import RequestsFile


def about_tree(tree: Tree, requests: RequestsFile) -> dict[str, Any]:
    """Which tree is in force, and what is wrong with it and with the requests file."""
    return {
        "tree": {
            "root": str(tree.root),
            "fingerprint": tree.desired.catalog.fingerprint,
            "revision": tree.revision,
            "errors": [d.as_json() for d in tree.errors],
        },
        "requests_errors": [str(d) for d in requests.diagnostics],
    }


def snapshot(decision: Decision, about: dict[str, Any]) -> dict[str, Any]:
    """`about` is put in front: who runs, on which tree."""
    situation = decision.situation
    return {
        **_of_all(decision, about),
        "runs": {n: _run_json(p, situation.now) for n, p in decision.memory.progress.items()},
        "services": {n: s.as_json() for n, s in statuses(situation, decision.plan, decision.holds).items()},
    }


class Snapshots:
    """The same as text, decision after decision, where what is said of a service is written anew only when something
    was found of it since."""

    def __init__(self) -> None:
        self._stale: set[str] | None = None
        """Services that were looked at since the last text; None for all."""
        self._services: dict[str, str] = {}
        self._runs: dict[str, tuple[Progress, str]] = {}

    def note(self, decision: Decision) -> None:
        """Every decision must be noted, whether a text of it is wanted or not."""
        if decision.whole:
            self._stale = None
        elif self._stale is not None:
            self._stale.update(decision.looked_at)

    def text(self, decision: Decision, about: dict[str, Any]) -> str:
        """Of the decision that was noted last."""
        head = json.dumps(_of_all(decision, about))
        runs, services = self._run_texts(decision), self._service_texts(decision)
        return f'{head[:-1]}, "runs": {_joined(runs)}, "services": {_joined(services)}}}'

    def _run_texts(self, decision: Decision) -> dict[str, str]:
        before, self._runs = self._runs, {}
        now = decision.situation.now
        for name, step in decision.memory.progress.items():
            known = before.get(name)
            timed = any(tried.at for tried in step.attempts.values()) if step.attempts else False
            same = known is not None and known[0] is step and not timed
            self._runs[name] = known if known and same else (step, json.dumps(_run_json(step, now)))
        return {name: text for name, (_, text) in self._runs.items()}

    def _service_texts(self, decision: Decision) -> dict[str, str]:
        situation, stale = decision.situation, self._stale
        if stale is not None and not situation.withheld:
            late = (n for n, p in situation.memory.progress.items() if p.running_since is not None and not p.ready)
            stale.update(late)  # with time alone
            found = statuses(situation, decision.plan, decision.holds, stale)
        else:
            self._services, found = {}, statuses(situation, decision.plan, decision.holds)
        self._services.update((name, json.dumps(status.as_json())) for name, status in found.items())
        self._stale = set()
        return self._services


def _joined(texts: Mapping[str, str]) -> str:
    return "{" + ", ".join(f"{json.dumps(name)}: {text}" for name, text in texts.items()) + "}"


def _of_all(decision: Decision, about: dict[str, Any]) -> dict[str, Any]:
    """What is not said of each service by itself."""
    situation = decision.situation
    requests = (*situation.desired.catalog.requests, *decision.settled.requests)
    return {
        **about,
        "engine": {"complete": situation.observed.complete, "error": situation.observed.error},
        "suspended": situation.suspended,
        "withheld": dict(situation.withheld),
        "requests": [request_json(r) for r in requests],
        "restarts": sorted(situation.restarts),
        "pressure": pressure_json(decision),
        "plan": decision.plan.as_json(),
        "in_flight": {n: f.action.verb for n, f in decision.memory.in_flight.items()},
    }


def _run_json(step: Progress, now: float) -> dict[str, Any]:
    """`attempts` are times of the machine's monotonic clock."""
    update = step.update
    more = {
        "edition": update.edition,
        "failed": update.failed,
        "error": update.error,
        "proven": update.proven,
        "loaded": update.run,
        "content": dict(update.content),
        "attempts": {verb: [t.at, t.error] for verb, t in step.attempts.items() if t.at > now},
    }
    return {
        "run": step.counted_on.run,
        "needs": dict(step.counted_on.needs),
        "stopped": step.stopped,
        **{k: v for k, v in more.items() if v},
    }


def restore(view: Mapping[str, Any] | None, now: float | None = None) -> Memory:
    """What of a loop's memory outlives it: on which runs of their needs services count, which runs it ended itself,
    which change failed, and what content a run has read. `view` is what it published; what is not as it should be is
    passed over. With `now`, of the machine's monotonic clock, also what it waits for, with that as time 0."""
    runs = view.get("runs") if isinstance(view, Mapping) else None
    found = {}
    for name, known in runs.items() if isinstance(runs, Mapping) else ():
        if isinstance(known, Mapping) and isinstance(known.get("needs"), Mapping):
            needs = {str(need): str(run) for need, run in known["needs"].items()}
            said = {k: str(known.get(k) or "") for k in ("edition", "failed", "error", "proven")}
            content, loaded = known.get("content"), str(known.get("loaded") or "")
            update = Update(
                edition=said["edition"],
                failed=said["failed"],
                error=said["error"],
                proven=said["proven"],
                run=loaded if isinstance(content, Mapping) else "",
                content={str(k): str(v) for k, v in content.items()} if isinstance(content, Mapping) else {},
            )
            found[name] = Progress(
                counted_on=CountedOn(str(known.get("run", "")), needs),
                update=update,
                stopped=str(known.get("stopped", "")),
                attempts={} if now is None else _tries(known.get("attempts"), now),
            )
    return Memory(found)


def _tries(known: Any, now: float) -> dict[str, Attempt]:
    found = {}
    for verb, said in known.items() if isinstance(known, Mapping) else ():
        if isinstance(said, list) and len(said) == 2 and isinstance(said[0], int | float):
            found[str(verb)] = Attempt(at=said[0] - now, error=str(said[1]))
    return found


def request_json(request: Request) -> dict[str, Any]:
    """A request as the API shows it."""
    return {
        "id": request.id,
        "requester": request.requester,
        "services": list(request.services),
        "reason": request.reason,
        "incarnation": request.incarnation,
        "standing": request.standing,
        "priority": request.priority,
        "ttl": request.ttl,
    }


def pressure_json(decision: Decision) -> dict[str, Any]:
    """Measures in force, mildest first, and what was shed."""
    state = decision.memory.pressure
    return {
        "reason": state.reason,
        "measures": [m for m in MEASURES if state.in_force(m)],
        "helpless": state.helpless,
        "shed": {s.service: s.reason for s in state.shed},
    }
