"""Asks whichever manager of the Swarm answers. Any of them passes a call on to their leader."""

from __future__ import annotations

import http.client
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from rorg.engines.docker.client import Client
from rorg.engines.docker.connect import engine_host
from rorg.engines.docker.errors import NoAnswer, Refused, reason
from rorg.errors import Unreachable

MANAGERS = "RORG_SWARM_MANAGERS"
"""The variable with their addresses, in the form of DOCKER_HOST, separated by commas."""
PATIENCE = 2.0
"""Seconds for one list. A manager without a leader answers after its own 20 s."""
T = TypeVar("T")


def managers_named() -> tuple[str, ...]:
    """The addresses of the managers: RORG_SWARM_MANAGERS, or else this machine's own engine."""
    named = os.environ.get(MANAGERS, "")
    return tuple(host.strip() for host in named.split(",") if host.strip()) or (engine_host(None),)


class Managers:
    """The managers at some addresses, from any thread."""

    def __init__(self, hosts: Sequence[str]) -> None:
        self.clients = [Client(host) for host in hosts]
        self._current = 0

    def ask(self, call: Callable[[Client], T]) -> T:
        """Return the first answer, beginning with the manager that answered last. The caller may be answered by
        another manager after one that has made the change and could not say so; a change names the version that it
        is made to, so it is not made twice. Raises what the last one said."""
        first = self._current
        for number in range(len(self.clients)):
            index = (first + number) % len(self.clients)
            try:
                answer = call(self.clients[index])
            except Refused as refused:
                if refused.status != 503 or number + 1 == len(self.clients):  # no manager, or one without a leader
                    raise
            except (OSError, http.client.HTTPException):
                if number + 1 == len(self.clients):
                    raise
            else:
                self._current = index
                return answer
        raise AssertionError("there is at least one")

    def answering(self) -> Client:
        """Return the one that answered last, for streams."""
        return self.clients[self._current]

    def nodes(self) -> list[dict[str, Any]]:
        """Return all nodes. Raises NoQuorum if most managers are lost: what the others say is no longer certain."""
        nodes: list[dict[str, Any]] = self.ask(lambda client: client.get("/nodes", PATIENCE))
        check_quorum(nodes)
        return nodes

    def close(self) -> None:
        for client in self.clients:
            client.close()


def check_quorum(nodes: Sequence[Mapping[str, Any]]) -> None:
    """Raise NoQuorum if half of the managers or fewer are reachable."""
    states = [node["ManagerStatus"].get("Reachability") for node in nodes if node.get("ManagerStatus")]
    if 2 * states.count("reachable") <= len(states):
        raise NoQuorum(f"{states.count('reachable')} of {len(states)} managers answer")


class NoQuorum(OSError):
    """Fewer than most managers answer, so the Swarm decides nothing."""


class Pinger:
    """Checks that most managers answer."""

    def __init__(self, managers: Managers) -> None:
        self._managers = managers
        self.close = managers.close

    def ask(self) -> None:
        try:
            self._managers.nodes()
        except NoAnswer as error:
            raise Unreachable("reach the Swarm", error.why) from error
        except Refused as refused:
            raise Unreachable("reach the Swarm", refused.text) from refused
        except (OSError, http.client.HTTPException, ValueError) as error:
            raise Unreachable("reach the Swarm", _why(error)) from error


def _why(error: Exception) -> str:
    return "no reply of its managers in time" if isinstance(error, TimeoutError) else reason(error)
