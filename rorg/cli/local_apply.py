"""`rorg apply` if no rorg runs: the loop runs here until there is nothing left to do, or waiting is hopeless."""

from __future__ import annotations

import threading
from typing import Any

from rorg.cli.context import Context
from rorg.cli.differences import Differences
from rorg.cli.output import note
from rorg.cli.published import PROVEN, SETTLED, UNTRIED, condition, hopeless
from rorg.cli.terminal import entry
from rorg.core.decide import Decision
from rorg.core.dispatch import DispatchLimits
from rorg.daemon.snapshot import snapshot
from rorg.daemon.tree import Tree
from rorg.errors import Incomplete
from rorg.model.causes import causes
from rorg.model.codes import BAKING
from rorg.model.units import counted

BULK = 8
"""Parallel engine calls: no rorg serves, so they cannot delay a request."""


def carry_out(context: Context, shown: Differences, wait: str | None, timeout: float) -> None:
    """Carries out the plan that was shown; if that is empty, the tree and the engine are not looked at again. Raises
    Incomplete."""
    first: Decision = shown.decision
    last, timed_out = first, False
    if not (shown.empty and _good_or_bad(first)):
        last, timed_out = _run(context, shown.tree, first, timeout)
    context.state.release()
    view = snapshot(last, {})
    failed = hopeless(view, view["services"])
    late = {**_late(view), **failed}
    for cause in causes(late.items()):
        note(entry("", f"{cause.who} {'is' if len(cause.names) == 1 else 'are'} not ready: {cause.why}"))
    baking = [w.service for w in last.plan.waitings if w.code == BAKING]
    if timed_out and baking and not late and _all_but_baked(last):
        note(entry("", f"still being watched: {', '.join(baking)}; the next rorg continues to check"))
        timed_out = False
    if timed_out or failed or (late and wait):
        raise Incomplete(
            counted(len(late), "service") + " not ready" + (f" after {timeout:g} s" if timed_out else ""),
            "`rorg describe SERVICE`",
        )
    idle = _idle(last, shown) if wait == PROVEN else []
    if idle:
        note(entry("", UNTRIED.format(f"not run since the change: {', '.join(idle)}")))


def _run(context: Context, tree: Tree, first: Decision, timeout: float) -> tuple[Decision, bool]:
    """Runs the loop: (the last decision, whether the time ran out)."""
    from rorg.daemon.wiring import loop_over

    loop = loop_over(tree, context.state, context.engine(), lambda line: note(entry("  ", line)))
    loop.dispatch = DispatchLimits(bulk=BULK)
    timed_out = threading.Event()

    def over() -> None:
        timed_out.set()
        loop.stop()

    timer = threading.Timer(timeout, over)
    timer.daemon = True
    timer.start()
    runs = {c.incarnation for c in first.situation.observed.containers}
    good_since: list[float] = []

    def finished(decision: Decision) -> bool:
        """True if it is hopeless, or good; good for SETTLED seconds if something has just begun."""
        good = _good_or_bad(decision) if loop.tree.loaded else None
        if good is None:
            good_since.clear()
            return False
        if not good or not _on_trust(decision, runs):
            return True
        if not good_since:
            good_since.append(loop.clock())
            threading.Timer(SETTLED, loop.wake).start()
        return loop.clock() - good_since[0] >= SETTLED

    loop.run(finished)
    timer.cancel()
    return loop.decision or first, timed_out.is_set()


def _on_trust(decision: Decision, before: set[str]) -> bool:
    """Whether something has begun since `before` that has no probe to say whether it is well."""
    services, memory = decision.situation.desired.catalog.services, decision.situation.memory
    return any(
        c.alive
        and c.incarnation not in before
        and c.service in services
        and (services[c.service].ready is None or memory.of(c.service).answered is None)
        for c in decision.situation.observed.containers
    )


def _good_or_bad(decision: Decision) -> bool | None:
    """True if everything possible is done, False if something failed, None while something goes on. Actions that only
    take time are waited for; those that may never happen are not."""
    if decision.memory.in_flight or decision.plan.actions:
        return None
    view = snapshot(decision, {})
    health = {s["health"] for s in view["services"].values()}
    if "Degraded" in health or hopeless(view, view["services"]):
        return False
    if decision.situation.suspended:
        return True
    return None if "Progressing" in health or any(w.goes_on for w in decision.plan.waitings) else True


def _all_but_baked(decision: Decision) -> bool:
    """Whether only the bake of new containers goes on."""
    waits = any(w.goes_on and w.code != BAKING for w in decision.plan.waitings)
    return not (decision.memory.in_flight or decision.plan.actions or waits)


def _idle(decision: Decision, shown: Differences) -> list[str]:
    """The services that the plan changed and that nothing wants, so that they cannot be proven now."""
    situation, names = decision.situation, {one["service"] for one in shown.services}
    updates = {n: situation.memory.of(n).update for n in sorted(names & situation.desired.editions.keys())}
    return [n for n, update in updates.items() if n not in situation.wanted and update.baked != update.edition]


def _late(view: dict[str, Any]) -> dict[str, str]:
    """Wanted services that are not ready, with the reason."""
    ready = {
        n: condition(s, "Ready") for n, s in view["services"].items() if s["health"] in ("Progressing", "Degraded")
    }
    return {name: readiness["message"] or readiness["reason"] for name, readiness in ready.items()}
