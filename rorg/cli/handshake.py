"""The first call of a command: does the rorg behind this socket or address answer?

Every command asks this before anything else, with a deadline, so that no one waits for an rorg that is stuck.
A socket file proves nothing: after `kill -9` it stays, and connecting is refused.
"""

from __future__ import annotations

import json
import os
import socket
import struct
from typing import TYPE_CHECKING, Any

from rorg.errors import Unreachable

if TYPE_CHECKING:
    from rorg_client import Client

ANSWER = 2.0
"""Seconds within which an rorg that works answers, however busy it is."""


def handshake(client: Client) -> dict[str, Any]:
    """What the rorg says of its engine (EngineView); empty if it says nothing. If connecting fails, the next call
    decides: it tries for longer. Raises Unreachable if an rorg is there and does not answer."""
    from rorg_client.connection import Connection
    from rorg_client.wire import asking, reading

    connection = None
    try:
        connection = Connection(client.address, ANSWER)
        connection.send(asking("GET", "/v1/engine", None, {}), ANSWER)
        answer = connection.drive(reading())
        found = json.loads(answer.body) if answer.status == 200 else {}
    except TimeoutError as error:
        raise _silent(str(client.address), connection.socket if connection else None) from error
    except (OSError, ValueError):
        return {}
    finally:
        if connection:
            connection.close()
    return found if isinstance(found, dict) else {}


def is_stale(path: str) -> bool:
    """Whether nobody is behind a socket: this user sees none there, or its process is no more."""
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


def _silent(where: str, connection: socket.socket | None) -> Unreachable:
    pid = _pid(connection)
    who = f"rorg (pid {pid}) has not answered" if pid else "it has not answered"
    if pid and _stopped(pid):
        return Unreachable(f"reach rorg on {where}", f"{who} within {ANSWER:g} s: it is stopped", f"`kill -CONT {pid}`")
    return Unreachable(f"reach rorg on {where}", f"{who} within {ANSWER:g} s", "`rorg doctor`, or starting it again")


def _pid(connection: socket.socket | None) -> int:
    """Of the process that listens at the other end; 0 where that is not known."""
    if connection is None or connection.family != socket.AF_UNIX:
        return 0
    told = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
    return int(struct.unpack("3i", told)[0])


def _stopped(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat", "rb") as file:
            return file.read().rpartition(b")")[2].split()[0] in (b"T", b"t")
    except (OSError, IndexError):
        return False
