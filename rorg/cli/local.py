"""What commands compute themselves, where no running rorg answers."""

from __future__ import annotations

import contextlib
import time
from dataclasses import replace
from typing import Any

from rorg.cli.context import Context
from rorg.core.decide import Decision, Inputs, decide
from rorg.core.desired import Desired, desire
from rorg.core.memory import Memory, ProbeResult
from rorg.core.observed import Observed
from rorg.core.schedule import Target
from rorg.daemon.snapshot import restore, snapshot
from rorg.host.contents import Contents
from rorg.model.catalog import Catalog
from rorg.probes.ask import CannotAsk
from rorg.probes.runner import ProbeRunner
from rorg.store.last_good import read_kept


def decision(context: Context, catalog: Catalog) -> Decision:
    """One pass without anything that could change the robot: observation, resolution, plan. Raises Unreachable."""
    desired = desire(catalog, str(context.state.run), Contents().of(catalog, context.root))
    document = context.document()
    observed = Observed(tuple(context.engine().list()))
    last = context.last() or {}
    owner = last.get("instance") or context.state.instance(lambda: "")

    def look(memory: Memory) -> Decision:
        # An interlock is asked when something is done; a plan that is only shown does not wait for it.
        allowed = {(n, "interlock"): ProbeResult("", True, 0.0) for n, s in catalog.services.items() if s.interlock}
        return decide(
            Inputs(
                desired=desired,
                requests=document.requests,
                restarts=document.restarts,
                observed=observed,
                results=allowed,
                memory=memory,
                now=0.0,
                owner=owner,
                holds=document.holds,
                suspended=document.suspended,
                wall=time.time(),
                confirmed=document.removals,
            )
        )

    # What the running rorg waits for, this one does too; all of one machine's clocks that are monotonic agree.
    running = context.published()
    memory = restore(running, time.monotonic()) if running else restore(context.last())
    memory = replace(memory, kept=read_kept(context.state.path))
    return look(_ready(context, look(memory), desired))


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
