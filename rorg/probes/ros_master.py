"""The ROS 1 graph through its master's XML-RPC: 1-2 ms a question, and no ROS installed (`rosnode ping`: 1.2 s).

Every answer of the master is [code, message, value]; code 1 is success.
"""

from __future__ import annotations

import http.client
import socket
import xmlrpc.client
from collections.abc import Iterable
from typing import Any
from urllib.parse import urlparse
from xml.parsers.expat import ExpatError

from rorg.probes.answer import YES, Answer, no

CALLER = "/rorg"
TIMEOUT = 1.0
"""Seconds for one call. A paused program accepts the connection and never answers."""


class _Transport(xmlrpc.client.Transport):
    """xmlrpc.client has no time-out of its own."""

    def __init__(self, timeout: float) -> None:
        super().__init__()
        self.timeout = timeout

    def make_connection(self, host: Any) -> http.client.HTTPConnection:
        chost, self._extra_headers, _ = self.get_host_info(host)
        return http.client.HTTPConnection(chost, timeout=self.timeout)


def call(uri: str, method: str, *args: Any, timeout: float = TIMEOUT) -> Any:
    """The value of a call that succeeded. Raises OSError when nobody answers, LookupError when the answer is no."""
    try:
        code, message, value = getattr(xmlrpc.client.ServerProxy(uri, transport=_Transport(timeout)), method)(*args)
    except (xmlrpc.client.Error, http.client.HTTPException, ExpatError, ValueError, TypeError) as error:
        raise OSError(f"{type(error).__name__}: {error}") from error
    if code != 1:
        raise LookupError(message)
    return value


def probe(kind: str, name: str, master: str) -> Answer:
    """Whether it is there. `kind` is ros_node, ros_topic or ros_service."""
    try:
        if kind == "ros_topic":
            publishers = call(master, "getSystemState", CALLER)[0]
            return YES if any(topic == name for topic, _ in publishers) else no(f"nobody publishes {name}")
        if kind == "ros_service":
            where = urlparse(call(master, "lookupService", CALLER, name))
            socket.create_connection((where.hostname or "", where.port or 0), timeout=TIMEOUT).close()
            return YES
        call(call(master, "lookupNode", CALLER, name), "getPid", CALLER)
        return YES
    except LookupError:
        return no(f"{name} is not registered")
    except OSError as error:
        return no(f"{name} does not answer: {error.strerror or error}")


def purge(master: str, local: Iterable[str]) -> list[str]:
    """Takes the registrations of dead nodes out of the master and returns their names. Dead is whose XML-RPC port, on
    this machine (`local` host names and addresses), refuses the connection; a paused node still accepts it, and
    purging that would cut it off for ever (`rosnode cleanup` does). Raises OSError when there is no master."""
    state = call(master, "getSystemState", CALLER)
    nodes = sorted({n for part in state for _, names in part for n in names})
    purged = []
    for node in nodes:
        try:
            uri = call(master, "lookupNode", CALLER, node)
        except LookupError:
            continue
        if urlparse(uri).hostname in local and not listens(uri):
            _unregister(master, node, uri, state)
            purged.append(node)
    return purged


def listens(uri: str) -> bool:
    """Whether anybody is there: only a refused connection says no. A paused program still accepts it."""
    where = urlparse(uri)
    try:
        socket.create_connection((where.hostname or "", where.port or 0), timeout=TIMEOUT).close()
    except ConnectionRefusedError:
        return False
    except OSError:
        pass
    return True


def _unregister(master: str, node: str, uri: str, state: Any) -> None:
    publishers, subscribers, services = state
    for topic in (t for t, names in publishers if node in names):
        call(master, "unregisterPublisher", node, topic, uri)
    for topic in (t for t, names in subscribers if node in names):
        call(master, "unregisterSubscriber", node, topic, uri)
    for service in (s for s, names in services if node in names):
        call(master, "unregisterService", node, service, call(master, "lookupService", CALLER, service))
