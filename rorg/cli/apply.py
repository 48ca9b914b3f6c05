"""rorg apply"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import typer

from rorg.cli.options import Directory, EngineName, StateDirectory, Timeout, Wait, Yes

if TYPE_CHECKING:
    from rorg.cli.context import Context
    from rorg.core.decide import Decision


SETTLED = 0.5
"""Seconds that everything must be well on end before apply says so."""


def command(directory: Directory = None, state_dir: StateDirectory = None, engine: EngineName = None,
            yes: Yes = False, wait: Wait = False, timeout: Timeout = 300.0) -> None:
    """Show the plan, ask, and carry it out: by itself, or through the rorg that runs on this state directory."""
    from rorg.cli.context import Context
    from rorg.cli.output import note

    context = Context(state_dir, engine, directory, local=True)
    catalog = context.catalog()
    owner = context.state.owner()
    if owner is None:
        context.state.acquire("rorg apply")
    plan = context.decision(catalog).plan
    note(plan.text().rstrip())
    if not plan.empty:
        _consent(yes)
    if owner is None:
        _alone(context, wait, timeout)
    else:
        _through(context, owner, catalog.fingerprint, wait, timeout)


def _consent(yes: bool) -> None:
    from rorg.errors import Refused

    if yes:
        return
    if not sys.stdin.isatty():
        raise Refused("apply the plan", "nobody was asked", "--yes")
    if not typer.confirm("Apply?", err=True):
        raise Refused("apply the plan", "you said no")


def _alone(context: Context, wait: bool, timeout: float) -> None:
    """Runs the loop here until there is nothing left to do."""
    import threading

    from rorg.cli.output import note
    from rorg.core.status import statuses
    from rorg.daemon.wiring import make_loop
    from rorg.errors import NotReady

    loop = make_loop(context.root, context.state, context.engine(), lambda line: note(f"  {line}"))
    seen: list[Decision] = []
    timed_out = threading.Event()
    timer = threading.Timer(timeout, lambda: (timed_out.set(), loop.stop()))
    timer.daemon = True
    timer.start()

    good_since: list[float] = []

    def finished(decision: Decision) -> bool:
        """Degraded, or good for SETTLED seconds on end: what crashes at its start does so within them."""
        good = good_or_bad(decision)
        if good is None:
            good_since.clear()
        elif not good_since:
            good_since.append(loop.clock())
            threading.Timer(SETTLED, loop.wake).start()
        return good is False or bool(good_since and loop.clock() - good_since[0] >= SETTLED)

    def good_or_bad(decision: Decision) -> bool | None:
        seen[:] = [decision]
        if not loop.tree.loaded or decision.memory.in_flight or decision.plan.actions:
            return None
        views = statuses(decision.situation, decision.plan).values()
        if any(s.health == "Degraded" or s.update_failed for s in views):
            return False
        return True if decision.plan.empty and not any(s.health == "Progressing" for s in views) else None

    loop.run(finished)
    timer.cancel()
    context.state.release()
    bad = {s.service: s for s in statuses(seen[0].situation, seen[0].plan).values()
           if s.health in ("Progressing", "Degraded") or s.update_failed} if seen else {}
    for status in bad.values():
        ready = next(c for c in status.conditions if c.type == "Ready")
        note(f"{status.service}: its change failed, {status.update_failed}; it stays as it was" if status.update_failed
             else f"{status.service} is not ready: {ready.message or ready.reason}")
    if timed_out.is_set() or (bad and wait):
        raise NotReady("finish", f"{len(bad)} service(s) are not ready" + (
            f" after {timeout:g} s" if timed_out.is_set() else ""), "`rorg describe SERVICE`")


def _through(context: Context, owner: dict[str, Any], fingerprint: str, wait: bool, timeout: float) -> None:
    """The running rorg follows its own tree; this only waits for it."""
    from pathlib import Path

    from rorg.cli.context import condition, unready
    from rorg.cli.output import note
    from rorg.errors import NotReady, Refused

    live = context.live()
    followed = (live or {}).get("tree", {}).get("root")
    if owner.get("what") != "rorg run" or (followed and Path(followed) != context.root.resolve()):
        raise Refused(f"apply {context.root}", f"{owner.get('what')} (pid {owner.get('pid')}) owns this robot"
                      + (f" and follows {followed}" if followed else ""), "to change that tree, or to stop it first")

    def done(view: dict[str, Any]) -> str:
        if view["tree"]["errors"]:
            return "it refused the manifests"
        if view["tree"]["fingerprint"] != fingerprint:
            return "it has not read these manifests yet"
        if view["plan"]["actions"] or view["in_flight"]:
            return view["plan"]["summary"]
        tried = [n for n, s in view["services"].items() if condition(s, "Updated")["status"] == "Unknown"]
        if wait and tried:
            return f"{', '.join(tried)}: it is to be seen whether the new container comes up"
        seen[:] = [view]
        return unready(view, sorted(n for n, s in view["services"].items() if s["wanted"])) if wait else ""

    seen: list[dict[str, Any]] = []
    note(f"rorg run (pid {owner.get('pid')}) carries it out")
    context.wait("the running rorg", done, timeout)
    failed = {n: c["message"] for n, s in seen[0]["services"].items()
              if (c := condition(s, "Updated"))["status"] == "False"}
    for name, why in failed.items():
        note(f"{name}: its change failed, {why}; it stays as it was")
    if failed and wait:
        raise NotReady("finish", f"{len(failed)} change(s) failed", "`rorg describe SERVICE`")
