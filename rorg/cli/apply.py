"""rorg apply"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from rorg.cli.options import Directory, EngineName, StateDirectory, Timeout, Wait, Yes
from rorg.cli.output import confirm, note

if TYPE_CHECKING:
    from rorg.cli.context import Context
    from rorg.cli.differences import Differences
    from rorg.core.decide import Decision


SETTLED = 0.5
"""Seconds that everything must be well on end before apply says so."""


def command(
    directory: Directory = None,
    state_dir: StateDirectory = None,
    engine: EngineName = None,
    yes: Yes = False,
    wait: Wait = False,
    timeout: Timeout = 300.0,
) -> None:
    """Show the plan, ask, and carry it out: by itself, or through the rorg that runs on this state directory."""
    from rorg.cli.context import Context
    from rorg.cli.differences import differences

    context = Context(state_dir, engine, directory, local=True)
    owner = {"what": "rorg run"} if context.remote else context.state.owner()
    if owner is None:
        context.state.acquire("rorg apply")
    shown = differences(context)
    note(shown.text.rstrip())
    if shown.withheld:
        note(f"To be removed on your word, though they are named: {', '.join(shown.withheld)}")
    if not shown.empty:
        _consent(yes)
    if owner is None:
        _confirm_here(context, shown)
        _alone(context, wait, timeout)
    else:
        _through(context, owner, shown, wait, timeout)


def _consent(yes: bool) -> None:
    from rorg.errors import Refused

    if yes:
        return
    if not sys.stdin.isatty():
        raise Refused("apply the plan", "nobody was asked", "--yes")
    if not confirm("Apply?"):
        raise Refused("apply the plan", "you said no")


def _confirm_here(context: Context, shown: Differences) -> None:
    """Writes down that what was shown may be removed, for the loop that begins."""
    from dataclasses import replace

    if shown.withheld:
        context.change(
            lambda document: replace(document, removals=tuple(dict.fromkeys((*document.removals, *shown.withheld))))
        )


def _alone(context: Context, wait: bool, timeout: float) -> None:
    """Runs the loop here until there is nothing left to do, or nothing that helps."""
    import threading

    from rorg.cli.context import hopeless
    from rorg.daemon.snapshot import snapshot
    from rorg.daemon.wiring import make_loop
    from rorg.errors import NotReady

    loop = make_loop(context.root, context.state, context.engine(), lambda line: note(f"  {line}"))
    view: dict[str, Any] = {"services": {}, "plan": {"waitings": []}}
    timed_out = threading.Event()
    timer = threading.Timer(timeout, lambda: (timed_out.set(), loop.stop()))
    timer.daemon = True
    timer.start()

    good_since: list[float] = []

    def finished(decision: Decision) -> bool:
        """Bad, or good for SETTLED seconds on end: what crashes at its start does so within them."""
        view.update(snapshot(decision, {}))
        good = _good_or_bad(decision, view) if loop.tree.loaded else None
        if good is None:
            good_since.clear()
        elif not good_since:
            good_since.append(loop.clock())
            threading.Timer(SETTLED, loop.wake).start()
        return good is False or bool(good_since and loop.clock() - good_since[0] >= SETTLED)

    loop.run(finished)
    timer.cancel()
    context.state.release()
    failed = hopeless(view, view["services"])
    late = {**_late(view), **failed}
    for name, why in late.items():
        note(f"{name} is not ready: {why}")
    if timed_out.is_set() or failed or (late and wait):
        raise NotReady(
            "finish",
            f"{len(late)} service(s) are not ready" + (f" after {timeout:g} s" if timed_out.is_set() else ""),
            "`rorg describe SERVICE`",
        )


def _good_or_bad(decision: Decision, view: dict[str, Any]) -> bool | None:
    """Whether all is done that can be; None while something goes on. What only takes its time is waited for, and what
    may never be done is not."""
    from rorg.cli.context import hopeless

    if decision.memory.in_flight or decision.plan.actions:
        return None
    health = {s["health"] for s in view["services"].values()}
    if "Degraded" in health or hopeless(view, view["services"]):
        return False
    if decision.situation.suspended:
        return True
    return None if "Progressing" in health or any(not w.code for w in decision.plan.waitings) else True


def _late(view: dict[str, Any]) -> dict[str, str]:
    """Wanted services that are not ready, with the reason."""
    from rorg.cli.context import condition

    ready = {
        n: condition(s, "Ready") for n, s in view["services"].items() if s["health"] in ("Progressing", "Degraded")
    }
    return {name: found["message"] or found["reason"] for name, found in ready.items()}


def _through(context: Context, owner: dict[str, Any], shown: Differences, wait: bool, timeout: float) -> None:
    """The running rorg follows its own tree; this hands it the confirmation of what was shown, and waits for it."""
    _follows(context, owner, shown)
    who = f"rorg at {context.remote}" if context.remote else f"{owner.get('what')} (pid {owner.get('pid')})"
    note(f"{who} carries it out")
    confirmed: list[str] = []

    def done(view: dict[str, Any]) -> str:
        if view["tree"]["errors"]:
            return "it refused the manifests"
        if view["tree"]["fingerprint"] != shown.fingerprint:
            return "it has not read these manifests yet"
        left = [n for n in shown.withheld if n in view.get("withheld", ())]
        if left and not confirmed:
            confirmed.extend(left)
            context.serving("confirm the removal").call("PUT", "/v1/removals", {"services": left})
        if left:
            return f"the removal of {', '.join(left)} has not begun"
        return _unfinished(view, wait)

    context.wait("the running rorg", done, timeout)


def _follows(context: Context, owner: dict[str, Any], shown: Differences) -> None:
    """Raises Refused where another rorg owns the robot, or it follows another tree."""
    from pathlib import Path

    from rorg.errors import Refused

    followed = None if shown.told else (context.live() or {}).get("tree", {}).get("root")
    if owner.get("what") != "rorg run" or (followed and Path(followed) != context.root.resolve()):
        raise Refused(
            f"apply {context.root}",
            f"{owner.get('what')} (pid {owner.get('pid')}) owns this robot"
            + (f" and follows {followed}" if followed else ""),
            "to change that tree, or to stop it first",
        )


def _unfinished(view: dict[str, Any], wait: bool) -> str:
    """Why the running rorg is not done; empty when it is. Raises NotReady where waiting helps nothing."""
    from rorg.cli.context import condition, hopeless, unready
    from rorg.errors import NotReady

    busy = view["plan"]["actions"] or view["in_flight"]
    failed = hopeless(view, view["services"]) if wait or not busy else {}
    if failed:
        raise NotReady(
            "wait for the running rorg",
            "; ".join(f"{n}: {why}" for n, why in failed.items()),
            "`rorg describe SERVICE`",
        )
    if busy:
        return str(view["plan"]["summary"])
    tried = [n for n, s in view["services"].items() if condition(s, "Updated")["status"] == "Unknown"]
    if wait and tried:
        return f"{', '.join(tried)}: it is to be seen whether the new container comes up"
    return unready(view, sorted(n for n, s in view["services"].items() if s["wanted"])) if wait else ""
