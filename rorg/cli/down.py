"""rorg down"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rorg_client import Error

from rorg.cli.context import Context
from rorg.cli.interlocks import Interlocks, locked
from rorg.cli.kinds import Seconds
from rorg.cli.options import RobotEngine, Timeout, Yes
from rorg.cli.output import consent, note, table
from rorg.cli.terminal import entry
from rorg.core.operations import ID
from rorg.errors import Invalid, NotReady, RorgError, Unreachable
from rorg.model.codes import INTERLOCK
from rorg.model.engines import capabilities_of
from rorg.model.units import counted

if TYPE_CHECKING:
    from rorg.core.decide import Decision
    from rorg.core.observed import Container
    from rorg.daemon.loop import Loop


def command(
    context: RobotEngine,
    yes: Yes = False,
    keep_requests: Annotated[
        bool, typer.Option("--keep-requests", help="Keep the requests for the next `rorg run`.")
    ] = False,
    volumes: Annotated[bool, typer.Option("--volumes", help="Also remove the robot's volumes with all data.")] = False,
    forget: Annotated[
        bool, typer.Option("--forget", help="Also remove the robot's history: all events and revisions.")
    ] = False,
    timeout: Timeout = Seconds(300),
) -> None:
    """Stop and remove all services of this robot, in order, then its networks. Manifests stay, and so do volumes and
    the history, unless you say otherwise. rorg never removes anything that it did not make.

    Example: rorg down --yes
    """
    client = context.client()
    if context.silence:
        raise Unreachable("take the robot down", context.silence, "again when it answers")
    others = _developed_in(context)
    if client is None and context.state.owner() is not None:
        raise Unreachable("take the robot down", "the rorg that owns it does not answer", "again in a moment")
    if client is None:
        _alone(context, yes, keep_requests, volumes, forget, timeout)
    else:
        view = client.status()
        rows = [*_rows(view["services"]), *_object_rows(view.get("objects", ()), volumes)]
        _consent(context, rows, len(view["requests"]), keep_requests, forget, yes)
        # An older rorg refuses the other fields.
        more = {name: True for name, said in (("volumes", volumes), ("forget", forget)) if said}
        client.call("PUT", "/v1/down", {"keep_requests": keep_requests} | more)
        _until_gone(context, timeout)
    note("the robot is down")
    for container in _not_removed(context):
        note(f"the engine does not remove {container.id[:ID]} of {container.service}; it is {container.state}")
    if others:
        note(f"dev containers remain: {', '.join(others)}; `rorg dev --stop` removes them")


def _not_removed(context: Context) -> list[Container]:
    """The containers that the engine has not removed. To ask it leaves no file behind, as all of `rorg down`."""
    if context.remote or not capabilities_of(context.engine_name).server:
        return []
    try:
        return list(context.engine().list())
    except RorgError:  # the robot is down, whatever engine this command takes for its own
        return []
    finally:
        (context.state.path / "instance.lock").unlink(missing_ok=True)


def _developed_in(context: Context) -> list[str]:
    """Names of dev containers: they are not services, and stay."""
    if context.remote or not context.state.homes.is_dir() or not capabilities_of(context.engine_name).images:
        return []
    from rorg.cli.dev_containers import Developing

    try:
        return [c.name for c in Developing(context).containers.list()]
    except RorgError:  # the next steps report what is wrong
        return []


def _rows(services: dict[str, Any]) -> list[dict[str, str]]:
    """The services that have a container of this machine."""
    return [
        {"name": name, "state": s["state"], "remark": "driver: moves hardware" if s["driver"] else ""}
        for name, s in sorted(services.items())
        if s["container"]
    ]


def _object_rows(views: Iterable[dict[str, Any]], volumes: bool) -> list[dict[str, str]]:
    """The networks and volumes that rorg made; volumes stay unless `volumes`."""
    lost = {True: "removed with all data", False: "stays; --volumes removes it"}
    return [
        {
            "name": f"{view['kind']}/{view['engine_name']}",
            "state": "",
            "remark": lost[volumes] if view["kind"] == "volume" else "removed",
        }
        for view in views
        if view["ours"]
    ]


def _consent(
    context: Context, rows: list[dict[str, str]], requests: int, keep_requests: bool, forget: bool, yes: bool
) -> None:
    """Shows what will be removed, and asks. Raises Refused."""
    if rows:
        note(table(rows, ("name", "state", "remark")))
    kept = "kept" if keep_requests else "forgotten"
    services = [row for row in rows if "/" not in row["name"]]
    note(
        f"to stop and remove: {counted(len(services), 'service')}; requests {kept}: {requests}; "
        "then rorg ends, and the manifests stay"
    )
    note(
        _lost_history(context) if forget else "the history stays: `rorg history`, `rorg rollback`; --forget removes it"
    )
    if not yes:
        consent("take the robot down", "Take this robot down?")


def _lost_history(context: Context) -> str:
    """What a person loses with the history."""
    from rorg.cli.records import records_of

    with records_of(context) as records:
        newest = records.listed(1)
    number = newest[0]["number"] if newest else 0
    lost = f"all events and {counted(number, 'revision')} of the manifests"
    return f"the history is removed: {lost}; `rorg rollback` and `rorg restore` cannot return to any of them"


def _until_gone(context: Context, timeout: float) -> None:
    """Waits until the running rorg has ended, or a later one reports that the robot is down. Raises NotReady."""
    client, began, left = context.serving("take the robot down"), time.monotonic(), "rorg still runs"
    interlocks = Interlocks()
    while time.monotonic() - began < timeout:
        try:
            view = client.status()
            if view.get("down") == "down":  # something has started rorg again
                return
            refusals = locked(view)
            interlocks.see(refusals)
            left = _with_reasons((row["name"] for row in _rows(view["services"])), refusals) or left
        except Error as error:
            if error.code == "unreachable" and (context.remote or context.state.owner() is None):
                return
        time.sleep(0.05)
    raise NotReady("take the robot down", f"not done after {timeout:g} s: {left}", "`rorg describe` for details")


def _alone(context: Context, yes: bool, keep_requests: bool, volumes: bool, forget: bool, timeout: float) -> None:
    """Takes the robot down if no rorg runs: the loop runs here until nothing is left."""
    from rorg.api.changes import down
    from rorg.daemon.wiring import make_loop
    from rorg.store.clear import clear
    from rorg.store.last_good import read_kept

    if not context.state.path.is_dir():
        raise Invalid(f"take the robot of {context.state.path} down", "no such directory", "another --state-dir")
    context.state.acquire("rorg down")
    containers, last = context.engine().list(), read_kept(context.state.path).catalog
    known = last.services if last else {}
    there = {
        c.service: {"state": c.state, "container": c.id, "driver": c.service in known and known[c.service].driver}
        for c in containers
    }
    rows = [*_rows(there), *_object_rows(_ours(context), volumes)]
    _consent(context, rows, len(context.document().requests), keep_requests, forget, yes)
    context.change(down(keep_requests, volumes, forget, "").edit)
    loop = make_loop(
        context.root,
        context.state,
        context.engine(),
        lambda line: note(entry("  ", line)),
        context.robot,
        notifies=False,
    )
    timer = threading.Timer(timeout, loop.stop)
    timer.daemon = True
    timer.start()
    over = threading.Event()
    threading.Thread(target=_report, args=(loop, over), daemon=True).start()
    loop.run()
    over.set()
    timer.cancel()
    if not loop.is_down:
        context.state.release()
        raise NotReady("take the robot down", f"not done after {timeout:g} s{_left(loop.decision)}", "`rorg describe`")
    clear(context.state, time.time())
    context.state.release()


def _ours(context: Context) -> list[dict[str, Any]]:
    """The networks and volumes of this robot on its engine."""
    from rorg.engines.protocol import Objects

    engine = context.engine()
    objects = engine.find_objects(()).found.values() if isinstance(engine, Objects) else ()
    return [{"kind": one.kind, "engine_name": one.called, "ours": True} for one in objects]


def _left(decision: Decision | None) -> str:
    """The containers that are still there, with the reason if known."""
    if decision is None:
        return ""
    waits = decision.plan.reasons()
    names = sorted({c.service for c in decision.situation.observed.containers})
    return ": " + _with_reasons(names, {name: reasons[-1] for name, reasons in waits.items()})


def _with_reasons(names: Iterable[str], reasons: Mapping[str, str]) -> str:
    return "; ".join(f"{name}: {reasons[name]}" if name in reasons else name for name in names)


def _report(loop: Loop, over: threading.Event) -> None:
    """Reports interlocks that keep the loop of this process from its end."""
    interlocks = Interlocks()
    while not over.wait(0.1):
        reasons = loop.decision.plan.reasons(INTERLOCK) if loop.decision else {}
        interlocks.see({name: waits[-1] for name, waits in reasons.items()})
