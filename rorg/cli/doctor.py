"""rorg doctor"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rorg_client import Client
from rorg_client import Error as ClientError

from rorg.cli.connection import handshake
from rorg.cli.context import Context
from rorg.cli.options import Output, RobotEngine
from rorg.cli.output import print_rows
from rorg.cli.places import NAME, may_connect
from rorg.errors import Exit, Refused, RorgError, Unreachable
from rorg.model.codes import REMOVAL, VANISHED
from rorg.model.engines import SWARM, capabilities_of
from rorg.model.units import counted

PATIENCE = 3.0
"""Longest time, in seconds, to wait for the running rorg."""

if TYPE_CHECKING:
    from rorg.core.doctor import Check
    from rorg.model.installation import Installation


def command(context: RobotEngine, output: Output = "table") -> None:
    """Check the installation and say what to do: the engine, control groups, the state directory, the running rorg,
    git, the clock, disks, kernel limits, and the targets of notifications. Exit 4 if something keeps rorg from
    working. For problems in manifests, run `rorg validate --machine`.

    Example: rorg doctor
    """
    from rorg.core.doctor import ERROR, examine

    checks = [*examine(_facts(context)), *_targets(context), *_vanished(context)]
    rows = [check.as_json() for check in checks]
    print_rows(rows, output, ("check", "status", "message", "remedy"), below=("message", "remedy"))
    if any(check.status == ERROR for check in checks):
        sys.exit(int(Exit.NOT_READY))


def _facts(context: Context) -> Installation:
    from rorg.history.damage import damaged_files
    from rorg.history.journal import fault
    from rorg.host import installation as host
    from rorg.host.git import refusal
    from rorg.host.machine import gather
    from rorg.model.installation import Installation

    state, machine = context.state, gather(())
    engine, images = _engine(context)
    places = (host.space(path) for path in (state.path, *images))
    spaces = {space.path: space for space in places if space}
    tree = ((context.last() or {}).get("tree") or {}).get("root")
    readable = state.readable
    return Installation(
        **engine,
        **_server(context),
        cgroup=machine.cgroup,
        pressure=os.path.exists("/proc/pressure/cpu"),
        state_dir=str(state.path),
        state_error=host.writable(state.path) if readable else f"you may not read {state.path}",
        unremoved=_unremoved(context),
        journal_error=fault(state.journal) if readable else "",
        journal_damaged=tuple(map(str, damaged_files(state.path))) if readable else (),
        git_version=host.git_version(),
        git_refusal=refusal(Path(tree)) if isinstance(tree, str) else "",
        clock_synchronized=host.clock_synchronized(),
        spaces=tuple(spaces.values()),
        open_files=host.open_files(),
        sysctls=machine.sysctls,
    )


def _unremoved(context: Context) -> tuple[str, ...]:
    """Containers that the engine does not remove, by the plan of the running rorg."""
    waitings = ((context.last() or {}).get("plan") or {}).get("waitings", ()) if context.state.owner() else ()
    return tuple(f"{w['service']}: {w['reason']}" for w in waitings if w["code"] == REMOVAL)


def _targets(context: Context) -> Iterator[Check]:
    """Whether what the running rorg notifies receives it."""
    from rorg.core.doctor import OK, WARNING, Check

    for target in ((context.last() or {}).get("notify") or ()) if context.state.owner() else ():
        name, error = f"notify {target['name']}", target["error"]
        if error:
            lost = counted(target["lost"], "notification")
            message = f"cannot notify {target['name']}: {error}; {lost} did not reach it"
            yield Check(name, WARNING, message, "to check its entry under `notify` in the Policy")
        else:
            yield Check(name, OK, f"{counted(target['sent'], 'notification')} sent")


def _vanished(context: Context) -> Iterator[Check]:
    """Services that the engine calls running although they have ended."""
    from rorg.core.doctor import WARNING, Check

    services = (context.last() or {}).get("services") or {} if context.state.owner() else {}
    for name, service in services.items():
        for condition in service["conditions"]:
            if condition["reason"] == VANISHED:
                remedy = "`systemctl restart docker`, if rorg cannot stop it"
                yield Check(f"service {name}", WARNING, condition["message"], remedy)


def _engine(context: Context) -> tuple[dict[str, Any], list[Path]]:
    """Known facts about the engine, and where it keeps its images."""
    if not capabilities_of(context.engine_name).server:
        return {"engine": context.engine_name}, []
    if context.engine_name == SWARM:
        return _swarm(context), []
    from rorg.engines.facts import engine_facts

    facts = engine_facts()
    fields = {
        "engine": context.engine_name,
        "engine_host": facts.host,
        "engine_error": facts.error,
        "engine_denied": facts.denied,
        "engine_product": facts.product,
        "engine_version": facts.version,
        "engine_lacks": facts.lacking,
        "live_restore": facts.live_restore,
    }
    return fields, [Path(facts.root)] if facts.root and facts.host.startswith("unix://") else []


def _swarm(context: Context) -> dict[str, Any]:
    """The same about the Swarm; its nodes are other machines."""
    engine = context.engine()
    try:
        about: dict[str, Any] = {"engine_product": engine.ping(), "live_restore": True}
    except RorgError as error:
        about = {"engine_error": error.why}
    return {"engine": SWARM, "engine_host": engine.address, **about}


def _server(context: Context) -> dict[str, Any]:
    """Whether an rorg runs on the state directory or at the given socket, and answers this user."""
    near = context.remote and not context.place.elsewhere
    owner, path = context.state.owner(), Path(context.remote) if near else context.state.run / NAME
    fields: dict[str, Any] = {"running": (owner or {}).get("pid", 0), "socket": str(path)}
    if not path.exists():
        return fields
    try:
        may_connect(str(path))
        client = Client(str(path), timeout=PATIENCE, patience=PATIENCE)
        handshake(client)
        client.call("GET", "/v1/status")
    except Refused as error:
        return {**fields, "socket_error": error.why}
    except (ClientError, Unreachable, OSError):
        return fields
    return {**fields, "answers": True}
