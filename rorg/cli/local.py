"""What commands compute themselves, where no running rorg answers."""

from __future__ import annotations

import contextlib
import time
from dataclasses import replace
from functools import cached_property
from typing import Any

from rorg.api import changes, views
from rorg.api.changes import Change
from rorg.api.current import Current
from rorg.api.inputs import read, request_of, seconds_of
from rorg.api.models import HoldBody, HoldsBody, PutRequest
from rorg.cli.context import Context, unready
from rorg.core.decide import Decision, Inputs, Target, decide
from rorg.core.desired import Desired, desire
from rorg.core.memory import Memory, ProbeResult
from rorg.core.observed import Observed
from rorg.core.status import statuses
from rorg.daemon.snapshot import restore, snapshot
from rorg.errors import Unreachable
from rorg.host.clock import wall_clock
from rorg.host.contents import Contents
from rorg.model.catalog import Catalog
from rorg.model.graph import closure
from rorg.probes.ask import CannotAsk
from rorg.probes.runner import ProbeRunner
from rorg.store.last_good import read_kept


class Local:
    """Operations where no rorg serves: they are written down for the next one, by the rules of the running one."""

    def __init__(self, context: Context) -> None:
        self.context = context

    @cached_property
    def current(self) -> Current:
        """As one pass sees it, without probing: whether something is ready changes nothing of what may be asked. Where
        the engine does not answer nothing is known of what runs, as in a pass of the loop."""
        catalog = self.context.catalog()
        return _current(_look(self.context, catalog, desire(catalog), _observed(self.context)))

    def put_request(self, id: str, requester: str, body: dict[str, Any]) -> None:
        renewed = wall_clock() if body.get("ttl") else ""
        request = request_of(id, requester, read(PutRequest, body), renewed)
        self._do(changes.put_request(self.current, request))

    def requesters(self, id: str) -> list[str]:
        return [r.requester for r in self.context.document().requests if r.id == id]

    def release(self, id: str, requester: str) -> None:
        self._do(changes.release((requester, id)))

    def restart(self, name: str, force: bool) -> list[str]:
        return self._do(changes.restart(self.current, name, force, time.time()))

    def hold(self, body: dict[str, Any]) -> list[str]:
        asked = read(HoldsBody, body)
        seconds = seconds_of(asked.duration, "duration")
        return self._do(changes.hold(self.current, asked.services, seconds, asked.reason, time.time()))

    def suspend(self, body: dict[str, Any] | None) -> None:
        asked = read(HoldBody, body) if body else None
        seconds = seconds_of(asked.duration, "duration") if asked else None
        self._do(changes.suspend(seconds, asked.reason if asked else "", time.time()))

    def why(self, name: str) -> list[dict[str, Any]]:
        return views.why(_current(decision(self.context, self.context.catalog())), name)

    def waiting(self, what: str) -> None:
        if self.context.state.owner() is None:
            raise Unreachable(what, "no rorg runs on this state directory", "`rorg run`")

    def wait(self, names: list[str], timeout: float, request: tuple[str, str] | None = None) -> None:
        """By what the rorg that owns the robot publishes."""
        what = ", ".join(names)
        self.waiting(f"wait for {what}")
        current, catalog = self.current, self.current.catalog
        asked = [m for s in names for m in current.members(s)]
        closed = [*asked, *sorted(closure(catalog.services, asked) - set(asked))]

        def done(view: dict[str, Any]) -> str:
            known = request is None or any((r["requester"], r["id"]) == request for r in view["requests"])
            return unready(view, closed) if known else "the request has not been read yet"

        self.context.wait(what, done, timeout)

    def _do(self, change: Change) -> list[str]:
        self.context.change(change.edit)
        return list(change.services)


def _current(found: Decision) -> Current:
    return Current(found, statuses(found.situation, found.plan, found.holds), found.situation.now)


def _observed(context: Context) -> Observed:
    """What runs; incomplete where the engine does not answer."""
    try:
        return Observed(tuple(context.engine().list()))
    except Unreachable as error:
        return Observed((), complete=False, error=str(error))


def decision(context: Context, catalog: Catalog) -> Decision:
    """One pass without anything that could change the robot: observation, resolution, plan. Raises Unreachable."""
    desired = desire(catalog, str(context.state.run), Contents().of(catalog, context.root))
    observed = Observed(tuple(context.engine().list()))
    first = _look(context, catalog, desired, observed)
    return _look(context, catalog, desired, observed, _ready(context, first, desired))


def _look(
    context: Context, catalog: Catalog, desired: Desired, observed: Observed, memory: Memory | None = None
) -> Decision:
    """What a pass decides, with the memory of the last rorg unless another one is given."""
    document = context.document()
    last = context.last() or {}
    owner = last.get("instance") or context.state.instance(lambda: "")

    if memory is None:
        # What the running rorg waits for, this one does too; all of one machine's clocks that are monotonic agree.
        running = context.published()
        memory = restore(running, time.monotonic()) if running else restore(last)
        memory = replace(memory, kept=read_kept(context.state.path))
    # An interlock is asked when something is done; a plan that is only shown does not wait for it.
    allowed = {(n, "interlock"): ProbeResult("", True, 0.0) for n, s in catalog.services.items() if s.interlock}
    return decide(
        Inputs(
            desired,
            document.requests,
            document.restarts,
            observed,
            allowed,
            memory,
            0.0,
            owner,
            holds=document.holds,
            suspended=document.suspended,
            wall=time.time(),
            confirmed=document.removals,
        )
    )


def _ready(context: Context, first: Decision, desired: Desired) -> Memory:
    """What is ready, found by one look at each: this process has seen nothing run yet."""
    progress = dict(first.situation.memory.progress)
    containers = first.situation.observed.by_service()
    ask = ProbeRunner(context.engine(), lambda name: next(iter(containers.get(name, [])), None))
    for name, step in progress.items():
        service = desired.catalog.services.get(name)
        ready = service.ready if service else None
        if step.running_since is None:
            continue
        with contextlib.suppress(CannotAsk):
            if ready is None or ready.kind == "delay" or not ask((name, "ready"), Target(ready, step.incarnation, 0.0)):
                progress[name] = replace(step, running_since=0.0, ready=True)
    return Memory(progress, kept=first.memory.kept)


def view(context: Context) -> dict[str, Any]:
    """What a running rorg would publish."""
    catalog = context.catalog()
    return snapshot(
        decision(context, catalog),
        {
            "pid": None,
            "engine_name": context.engine_name,
            "tree": {"root": str(context.root), "fingerprint": catalog.fingerprint, "revision": "", "errors": []},
        },
    )
