"""The route behind `rorg diff` and `rorg apply`: what rorg would do, after a fresh look at the tree and the engine."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace
from typing import Any

from fastapi import FastAPI
from fastapi.responses import Response

from rorg.api.callers import needs
from rorg.api.generations import reached, until
from rorg.api.models import Differences
from rorg.api.operations import Operations
from rorg.api.views import plan_forms
from rorg.core.decide import Decision
from rorg.core.plan import Plan, Waiting
from rorg.daemon.commit_tree import CommitTree, load_at
from rorg.errors import Busy, RorgError, Unreachable
from rorg.history.revisions import Revisions, for_git

PATIENCE = 2.0
"""Longest time, in seconds, to wait for a tree that is being written."""


def add_diffing(app: FastAPI, operations: Operations) -> None:
    """Adds the route."""
    reading = asyncio.Lock()
    """Held while a state from the history is read: all its files are in memory, so one at a time."""

    @app.get("/v1/diff", dependencies=[needs("plan")], response_model=Differences)
    async def diff(unified: bool = False, rev: str = "") -> Response:
        """The actions that rorg would take, and why. It first looks at the tree and the engine again, so that earlier
        changes and drift count. `unified`: with a unified diff of each container that changes. `rev`: the plan if
        the manifests of this revision, commit, tag or branch were in force; nothing of it is done."""
        await _look(operations)
        if rev:
            async with reading:
                name = for_git(rev, Revisions(operations.recorder.history))
                past = await asyncio.to_thread(load_at, operations.tree, name)
            answer = differences(operations, unified, past)
        else:
            answer = differences(operations, unified)
        return Response(json.dumps(answer), media_type="application/json")


async def _look(operations: Operations) -> None:
    """Returns when the last decision has seen the tree and the engine as they are now. Raises Unreachable, and Busy
    while the tree is being written."""
    operations.check_engine("list the actions")
    try:
        await asyncio.to_thread(operations.observe)
    except RorgError as error:
        raise Unreachable("list the actions", error.why, error.remedy) from error
    await reached(operations, operations.files_changed())
    await until(operations, lambda: not operations.reading_files, PATIENCE)
    if operations.tree.busy:
        raise Busy("list the actions", "the manifests are being written", "again in a moment")


def differences(operations: Operations, unified: bool, past: CommitTree | None = None) -> dict[str, Any]:
    """The plan of the last decision, with the mistakes in the tree; or the plan if a past state of the manifests were
    in force."""
    about = operations.about_tree()
    tree = about["tree"]
    decision = operations.suppose(past.desired) if past else operations.decision
    return {
        "root": tree["root"],
        "robot": tree["robot"],
        "commit": past.commit if past else "",
        "errors": [] if past else tree["errors"],
        "warnings": [] if past else tree["warnings"],
        "requests_errors": about["requests_errors"],
        **plan_forms(
            decision,
            decision.plan if past else with_calls_under_way(decision),
            unified,
            operations.catalog if past else None,
        ),
    }


def with_calls_under_way(decision: Decision) -> Plan:
    """The plan, with a waiting for each service that has a call under way: rorg plans for it again when the call
    ends."""
    waitings = [
        Waiting(name, f"{flight.action.verb} is under way ({flight.action.reason})")
        for name, flight in decision.memory.in_flight.items()
    ]
    return replace(decision.plan, waitings=(*decision.plan.waitings, *waitings))
