"""rorg apply"""

from __future__ import annotations

import time
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from rorg.cli.context import Context
from rorg.cli.differences import Differences, differences, warn_of_other_tree
from rorg.cli.kinds import Seconds
from rorg.cli.options import Output, Timeout, TreeDirectory, WaitFor, Yes
from rorg.cli.output import consent, note, print_rows
from rorg.cli.published import PROVEN, READY, SETTLED, UNTRIED, condition, failure, hopeless, unready
from rorg.errors import NotReady, Refused
from rorg.model.codes import CONFIRM, IMAGE
from rorg.model.units import stamp
from rorg.store.state_dir import SERVER

if TYPE_CHECKING:
    from rorg.store.requests_document import RequestsDocument


def command(
    context: TreeDirectory,
    yes: Yes = False,
    wait: WaitFor = None,
    timeout: Timeout = Seconds(300),
    output: Output = "table",
) -> None:
    """Show the plan, ask, and carry it out, through the running rorg if there is one.

    Example: rorg apply --yes --wait --timeout 5m
    """
    owner = taken(context, "rorg apply")
    if owner is not None:
        _fetch(context)
    shown = differences(context)
    agree(context, owner, shown, "apply the plan", question="Apply?", yes=yes)
    bring_about(context, owner, shown, wait, timeout)
    print_rows(shown.plan["actions"], output, ("service", "verb", "reason"), full=shown.plan, text="")


def taken(context: Context, command: str) -> dict[str, Any] | None:
    """The owner of the robot, which carries out the plan; None if this command owns it from now on."""
    owner = {"what": SERVER} if context.remote else context.state.owner()
    if owner is None:
        context.state.acquire(command)
    return owner


def agree(
    context: Context,
    owner: dict[str, Any] | None,
    shown: Differences,
    what: str,
    *,
    question: str,
    yes: bool,
    nothing: bool = True,
) -> None:
    """Shows the plan, and asks unless there is `nothing` else to agree to and nothing to do. Raises Refused."""
    if owner is not None:
        _follows(context, owner, shown)
        if (context.live() or {}).get("down"):
            raise Refused(what, "the robot is down", "`rorg up`")
    warn_of_other_tree(context, shown)
    note(shown.overview().rstrip())
    if shown.withheld:
        note(f"To remove after you confirm, although still named: {', '.join(shown.withheld)}")
    if shown.unconfirmed:
        note(f"To change after you confirm, although a driver in use ends: {', '.join(shown.unconfirmed)}")
    if shown.suspended and (shown.plan["actions"] or shown.withheld or shown.unconfirmed):
        raise Refused(what, f"rorg is {shown.suspended}", "`rorg suspend --end`")
    if not ((shown.empty and nothing and not shown.unconfirmed) or yes):
        consent(what, question)


def bring_about(
    context: Context, owner: dict[str, Any] | None, shown: Differences, wait: str | None, timeout: float
) -> None:
    """Carries out the plan, and returns when that is done; with `wait`, when everything is READY or PROVEN. Raises
    NotReady."""
    if owner is None:
        from rorg.cli.local_apply import carry_out

        _confirm_here(context, shown)
        carry_out(context, shown, wait, timeout)
    else:
        _through(context, owner, shown, wait, timeout)


def _fetch(context: Context) -> None:
    """Makes a running rorg that follows a repository fetch it first."""
    client = context.client()
    git = ((context.live() or {}).get("tree") or {}).get("git") or {}
    if client is None or not git.get("followed"):
        return
    answer = client.call("POST", "/v1/fetch")
    told = f"{answer['repository']}: {answer['error'] or 'is at ' + (answer['commit'][:10] or 'nothing yet')}"
    note(told)


def _confirm_here(context: Context, shown: Differences) -> None:
    """Confirms the removals and the changes of drivers in use that were shown, for the loop that begins, and that the
    robot is no longer down."""
    from dataclasses import replace

    restarts = dict.fromkeys(shown.unconfirmed, stamp(time.time()))

    def edit(document: RequestsDocument) -> RequestsDocument:
        risen = document.up() if document.down_since else document
        removals = tuple(dict.fromkeys((*risen.removals, *shown.withheld)))
        return replace(risen, removals=removals, restarts={**risen.restarts, **restarts})

    context.change(edit)


def _through(context: Context, owner: dict[str, Any], shown: Differences, wait: str | None, timeout: float) -> None:
    """Confirms what was shown to the running rorg, which follows its own tree, and waits until it is done."""
    who = f"rorg at {context.remote}" if context.remote else f"{owner.get('what')} (pid {owner.get('pid')})"
    note(f"{who} carries it out")
    asked: list[str] = []
    planned = {action["service"] for action in shown.plan["actions"]}

    def done(view: dict[str, Any]) -> str:
        if view["tree"]["errors"]:
            return "it refused the manifests"
        if view["tree"]["fingerprint"] != shown.fingerprint:
            return "it has not read these manifests yet"
        left = [n for n in shown.withheld if n in view.get("withheld", ())]
        waits = [w["service"] for w in view["plan"]["waitings"] if w.get("code") == CONFIRM]
        changes = [n for n in shown.unconfirmed if n in waits]
        if (left or changes) and not asked:
            asked.extend((*left, *changes))
            _confirm(context, left, changes)
        if left:
            return f"the removal of {', '.join(left)} has not begun"
        if changes:
            return f"the change of {', '.join(changes)} has not begun"
        unfinished = _unfinished(view, bool(wait), planned) or (_on_trust(view, shown.probed) if wait else "")
        if wait == PROVEN and not unfinished and (failed := _failed(view)):
            raise NotReady("wait for the running rorg", failed, "`rorg history`")
        return unfinished or (_unproven(view) if wait == PROVEN else "")

    context.wait("the running rorg", done, timeout)
    if wait == PROVEN and (left := _untried(context.live() or {})):
        note(UNTRIED.format(left))
    if wait == READY and (left := _unproven(context.live() or {})):
        note(f"ready, but {left}; `rorg apply --wait=proven` waits for that")


def _confirm(context: Context, removals: list[str], changes: list[str]) -> None:
    """Confirms removals, and changes that end drivers in use: a restart makes them, as a person may ask for one."""
    client = context.serving("confirm the plan")
    if removals:
        client.call("PUT", "/v1/removals", {"services": removals})
    for name in changes:
        client.call("POST", f"/v1/services/{quote(name, safe='')}/restart?force=true")


def _follows(context: Context, owner: dict[str, Any], shown: Differences) -> None:
    """Raises Refused if another program owns the robot, or rorg follows another tree."""
    tree = {} if shown.told else (context.live() or {}).get("tree", {})
    followed, robot = tree.get("root"), tree.get("robot") or ""
    other = followed and (Path(followed) != context.root.resolve() or robot != context.robot)
    if owner.get("what") != SERVER or other:
        raise Refused(
            f"apply {context.root}",
            f"{owner.get('what')} (pid {owner.get('pid')}) owns this robot"
            + (f" and follows {followed}{f' for {robot}' if robot else ''}" if followed else ""),
            "to change that tree, or stop that program first",
        )


def _on_trust(view: dict[str, Any], probed: list[str]) -> str:
    """The services that have just begun to run and have no probe that says whether they are well; empty without any."""
    now = time.time()
    since, until = stamp(now - SETTLED), stamp(now)
    fresh = [
        name
        for name, s in view["services"].items()
        if s["wanted"] and s["incarnation"] and since < s["started_at"] <= until and name not in probed
    ]
    return f"{', '.join(fresh)}: it has just begun" if fresh else ""


def _unproven(view: dict[str, Any]) -> str:
    """Why the manifests in force are not known to stay well; empty if they are, or have failed."""
    standing = (view.get("tree") or {}).get("standing") or {}
    return str(standing["reason"]) if standing.get("code") in ("applying", "baking") else ""


def _untried(view: dict[str, Any]) -> str:
    """Why the manifests in force cannot be proven: services that they change are idle; empty otherwise. Waiting does
    not help, and nothing has failed, so this is no error."""
    standing = (view.get("tree") or {}).get("standing") or {}
    return str(standing["reason"]) if standing.get("code") == "untested" else ""


def _failed(view: dict[str, Any]) -> str:
    """Why the manifests in force have failed, also for a service that is idle; empty if they have not."""
    standing = view["tree"].get("standing") or {}
    return str(standing["reason"]) if standing.get("code") == "failed" else ""


def _unfinished(view: dict[str, Any], wait: bool, planned: Collection[str]) -> str:
    """Why the running rorg is not done; empty if it is. Without `wait` only what was planned has to be done, since
    requests of others may come and go all the time. Raises NotReady if waiting is hopeless."""
    images = any(w.get("code") == IMAGE for w in view["plan"]["waitings"])
    if not view["engine"]["complete"]:
        return str(view["engine"]["error"]) or "it is not known what runs"
    under_way = [*view["in_flight"], *(action["service"] for action in view["plan"]["actions"])]
    busy = images or any(wait or service in planned for service in under_way)
    failed = hopeless(view, view["services"]) if wait or not busy else {}
    if failed:
        raise NotReady(
            "wait for the running rorg",
            failure(failed),
            "`rorg describe SERVICE`",
        )
    if busy:
        return str(view["plan"]["summary"])
    tried = [n for n, s in view["services"].items() if condition(s, "Updated")["reason"] == "OnTrial"]
    if wait and tried:
        return f"{', '.join(tried)}: it is not known yet whether the new container becomes ready"
    return unready(view, sorted(n for n, s in view["services"].items() if s["wanted"])) if wait else ""
