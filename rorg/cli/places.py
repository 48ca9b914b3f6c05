"""Where commands find the robot: a given socket or state directory, the machine's robot, or the user's own. A socket
file proves nothing: it remains after `kill -9`, and connecting is refused."""

from __future__ import annotations

import os
import socket
from pathlib import Path
from typing import NamedTuple

from rorg.errors import Refused, Unreachable
from rorg.store.state_dir import MACHINE, StateDir, default_state_dir

NAME = "rorg.sock"


class Place(NamedTuple):
    """`remote` is a socket or an address, if only that is known of rorg; otherwise it is empty. `state` is then the
    robot's state directory; with `remote` it may belong to no robot."""

    remote: str
    state: StateDir

    @property
    def elsewhere(self) -> bool:
        """Whether rorg is, or may be, on another machine."""
        return "://" in self.remote

    def too_far(self, what: str) -> Refused:
        """The error for what needs more than the API."""
        if self.elsewhere:
            why = f"RORG_ADDRESS is {self.remote}, and this only works where rorg runs"
            return Refused(what, why, "to run it there, or unset RORG_ADDRESS")
        why = f"only the socket {self.remote} of rorg is known, and it cannot do this"
        return Refused(what, why, "as root, or with its --state-dir")


def find(state_dir: Path | None, own: bool = False) -> Place:
    """Finds the robot. Options come before the environment: --socket (which `signature.call` puts into RORG_SOCKET) or
    --state-dir, then RORG_SOCKET, RORG_ADDRESS, RORG_STATE_DIR. Without any: the user's own rorg while it runs, or the
    machine's if it has a socket, or the user's state directory. `own`: always a state directory."""
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


def socket_of(machine: str, state_dir: Path | None) -> str:
    """The socket through which the running rorg asks another machine. Raises Refused without one, and for a robot whose
    rorg is on another machine."""
    place = find(state_dir)
    what = f"ask {machine}"
    if place.elsewhere:
        raise place.too_far(what)
    folder = Path(place.remote).parent if place.remote else place.state.run
    path = folder / "machines" / f"{machine}.sock"
    if not os.path.exists(path):
        raise Refused(what, "the running rorg knows no other machine of that name", "`rorg get machines`")
    return str(path)


def _left_by(path: str, state: StateDir) -> StateDir | None:
    """The state directory of the rorg that was killed and left this socket; None if one serves there, or its directory
    is unknown."""
    if "://" in path or not os.path.exists(path) or not is_stale(path):
        return None
    folder = Path(path).absolute().parent
    known = (state, StateDir(MACHINE), StateDir(folder.parent))
    return next((s for s in known if s.run.resolve() == folder.resolve() and (s.path / "instance").exists()), None)


def may_connect(path: str) -> None:
    """Raises Refused if this user may not connect to a socket. Whether anything answers there is checked later."""
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
        return Refused(what, f"you may not read {os.path.dirname(path)}", f"`sudo ls {error.filename}`")
    group = _group_of(about.st_gid)
    if about.st_gid == 0 or not about.st_mode & 0o020:
        return Refused(what, "no group may use it", "`rorg run --group GROUP`, or as root")
    return Refused(what, f"you are not in the group {group}", f"`sudo usermod -aG {group} $USER` and log in again")


def _group_of(number: int) -> str:
    import grp

    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)


def nobody(what: str, state: StateDir) -> Unreachable:
    """The error if a running rorg is needed and there is none."""
    if not state.readable:
        why = f"you may not read {state.path}, and nothing serves at {state.run / NAME}"
        return Unreachable(what, why, "to run it as root, or name another rorg with --socket or --state-dir")
    why = f"no rorg runs on {state.path}"
    return Unreachable(what, f"{why}; start one with `rorg run`, or name another with --state-dir")


def is_stale(path: str) -> bool:
    """Whether nothing listens at a socket: it is missing, or its process is gone."""
    if not os.path.exists(path):
        return True
    probe = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        probe.setblocking(False)
        probe.connect(path)
    except (ConnectionRefusedError, FileNotFoundError):
        return True
    except OSError:
        return False
    finally:
        probe.close()
    return False
