"""The route behind `rorg diff` and `rorg apply`: what is to be done, by a look at tree and engine of its own."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from fastapi import FastAPI
from fastapi.responses import Response

from rorg.api.callers import needs
from rorg.api.models import Differences
from rorg.api.not_before import reached
from rorg.api.operations import Operations
from rorg.api.plan_forms import shown
from rorg.core.decide import Decision
from rorg.core.plan import Plan, Waiting
from rorg.daemon.commit_tree import CommitTree, load_at
from rorg.daemon.snapshot import about_tree
from rorg.errors import Busy, RorgError, Unreachable
from rorg.history.names import for_git
from rorg.history.revisions import Revisions

PATIENCE = 2.0
"""Seconds to wait at the most for a tree that is being written."""


def add_diffing(app: FastAPI, operations: Operations, changed: Callable[[], asyncio.Event]) -> None:
    """The route by which commands see what would change."""
    reading = asyncio.Lock()
    """One state of the history at a time: all its files are read for it."""

    @app.get("/v1/diff", dependencies=[needs("plan")], response_model=Differences)
    async def diff(unified: bool = False, rev: str = "") -> Response:
        """What is to be done, and why. The tree and the engine are looked at anew first, so that what was written, or
        drifted, until now counts. `unified`: with a unified diff of each container that is changed. `rev`: what would
        be done if the manifests of this revision, commit, tag or branch were in force; nothing is done of it."""
        await _look(operations, changed)
        if rev:
            async with reading:
                past = await asyncio.to_thread(_past, operations, rev)
            found = supposed(operations, past, unified)
        else:
            found = differences(operations, unified)
        return Response(json.dumps(found), media_type="application/json")


def _past(operations: Operations, rev: str) -> CommitTree:
    loop = operations.loop
    return load_at(loop.tree, for_git(rev, Revisions(loop.recorder.history)))


async def _look(operations: Operations, changed: Callable[[], asyncio.Event]) -> None:
    """Returns when the last decision has seen how tree and engine are now. Raises Unreachable, or Busy while the tree
    is being written."""
    loop = operations.loop
    operations.check_engine("say what is to be done")
    try:
        await asyncio.to_thread(loop.observer.sync, False)
    except RorgError as error:
        raise Unreachable("say what is to be done", error.why, error.remedy) from error
    loop.wakes.files_changed()
    await reached(operations, operations.changed(), changed)
    clock = asyncio.get_running_loop().time
    end = clock() + PATIENCE
    while loop.wakes.files and clock() < end:
        event = changed()
        if loop.wakes.files:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(event.wait(), end - clock())
    if loop.tree.busy:
        raise Busy("say what is to be done", "the manifests are being written", "again in a moment")


def differences(operations: Operations, unified: bool) -> dict[str, Any]:
    """The last decision's plan, with what is wrong with the tree."""
    decision = operations.decision
    about = about_tree(operations.loop.tree, operations.loop.leases.file)
    return {
        "root": about["tree"]["root"],
        "robot": about["tree"]["robot"],
        "commit": "",
        "errors": about["tree"]["errors"],
        "warnings": about["tree"]["warnings"],
        "requests_errors": about["requests_errors"],
        **shown(decision, with_calls_under_way(decision), unified),
    }


def supposed(operations: Operations, past: CommitTree, unified: bool) -> dict[str, Any]:
    """The same of what a state of the manifests from the history would come to."""
    decision, about = operations.suppose(past.desired), about_tree(operations.loop.tree, operations.loop.leases.file)
    return {
        "root": about["tree"]["root"],
        "robot": about["tree"]["robot"],
        "commit": past.commit,
        "errors": [],
        "warnings": [],
        "requests_errors": about["requests_errors"],
        **shown(decision, decision.plan, unified),
    }


def with_calls_under_way(decision: Decision) -> Plan:
    """The plan, in which each service with a call under way waits for its end: it is planned for again only then."""
    waitings = [
        Waiting(name, f"{flight.action.verb} is under way ({flight.action.reason})")
        for name, flight in decision.memory.in_flight.items()
    ]
    return replace(decision.plan, waitings=(*decision.plan.waitings, *waitings))
