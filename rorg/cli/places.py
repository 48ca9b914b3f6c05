"""Where commands look for the robot: a socket that is named, a state directory, the machine's robot, the user's own."""

from __future__ import annotations

import os
import socket
from pathlib import Path
from typing import NamedTuple

from rorg.cli.handshake import is_stale
from rorg.errors import Refused, Unreachable
from rorg.store.state_dir import MACHINE, StateDir, default_state_dir

NAME = "rorg.sock"


class Place(NamedTuple):
    """`remote` is where rorg is when that is all that is known of it, or may be: a socket, or an address. The state
    directory is that of this robot where it is empty, else one that may be no robot's."""

    remote: str
    state: StateDir

    @property
    def elsewhere(self) -> bool:
        """On another machine, or it may be."""
        return "://" in self.remote

    def too_far(self, what: str) -> Refused:
        """For what is only done where all of the robot can be seen."""
        if self.elsewhere:
            why = f"RORG_ADDRESS is {self.remote}, and this is only done where rorg runs"
            return Refused(what, why, "it there, or unsetting RORG_ADDRESS")
        why = f"rorg is only known by its socket {self.remote}, which does not do this"
        return Refused(what, why, "as root, or with its --state-dir")


def find(state_dir: Path | None, own: bool = False) -> Place:
    """What a line names comes before the environment: --socket (which `signature.call` puts there) or --state-dir, then
    RORG_SOCKET, RORG_ADDRESS, RORG_STATE_DIR. Where nothing is named: the user's own rorg while it runs, else
    the machine's where it has a socket, else the user's state directory. `own`: a state directory, whoever runs."""
    named = state_dir or (Path(given) if (given := os.environ.get("RORG_STATE_DIR")) else None)
    remote = os.environ.get("RORG_SOCKET") or os.environ.get("RORG_ADDRESS") or ""
    state = StateDir(named or default_state_dir())
    if own or state_dir or not remote:
        machine, remote = StateDir(MACHINE), ""
        if not (own or named or state.owner()) and not is_stale(str(machine.run / NAME)):
            state, remote = machine, "" if machine.owner() else str(machine.run / NAME)
    elif here := _left_by(remote.removeprefix("unix://"), state):
        state, remote = here, ""
    path = str(state.run / NAME)
    if not (own or remote or state.readable) and not is_stale(path):
        remote = path
    return Place(remote.removeprefix("unix://"), state)


def _left_by(path: str, state: StateDir) -> StateDir | None:
    """The state directory of the rorg that served at a socket and was killed; None where one serves, or it is not known
    which it was."""
    if "://" in path or not os.path.exists(path) or not is_stale(path):
        return None
    folder = Path(path).absolute().parent
    known = (state, StateDir(MACHINE), StateDir(folder.parent))
    return next((s for s in known if s.run.resolve() == folder.resolve() and (s.path / "instance").exists()), None)


def may_connect(path: str) -> None:
    """Raises Refused where this user may not talk to the rorg at a socket. Whether any answers is found out by who
    asks."""
    probe = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        probe.settimeout(1.0)
        probe.connect(path)
    except PermissionError as error:
        raise _not_allowed(path) from error
    except OSError:
        return
    finally:
        probe.close()


def _not_allowed(path: str) -> Refused:
    what = f"talk to rorg at {path}"
    try:
        about = os.stat(path)
    except OSError as error:
        return Refused(what, f"you may not look into {os.path.dirname(path)}", f"`sudo ls {error.filename}`")
    group = _group_of(about.st_gid)
    if about.st_gid == 0 or not about.st_mode & 0o020:
        return Refused(what, "it has been given to no group", "`rorg run --group GROUP`, or as root")
    return Refused(what, f"you are not in the group {group}", f"`sudo usermod -aG {group} $USER` and log in again")


def _group_of(number: int) -> str:
    import grp

    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)


def nobody(what: str, state: StateDir) -> Unreachable:
    """Where a running rorg is needed, and there is none."""
    if not state.readable:
        why = f"you may not look into {state.path}, and nothing serves at {state.run / NAME}"
        return Unreachable(what, why, "as root, or another one with --socket or --state-dir")
    why = f"no rorg runs on {state.path}"
    return Unreachable(what, f"{why}; start one with `rorg run`, or name another with --state-dir")
