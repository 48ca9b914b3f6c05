"""All that a ROS 1 master has registered, with the places of the nodes; and taking registrations out of it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from rorg.host.asking import connect, place_of
from rorg.host.deadline import Deadline
from rorg.probes.ros_master import CALLER, TIMEOUT, Graph, ask, call, graph, value_of

READING = 5.0
"""Seconds for the whole state of a master."""


@dataclass(frozen=True, slots=True)
class RosState:
    """Of one master. `graph`: publishers, subscribers and services."""

    graph: Graph
    places: dict[str, str]
    """Node -> URI of its XML-RPC; of those that are registered still when it is asked for."""


def read_state(master: str) -> RosState:
    """Two calls, whatever the number of nodes. Raises OSError when there is no master."""
    deadline = Deadline.within(READING)
    found = graph(master, deadline.sooner(TIMEOUT))
    nodes = sorted({n for part in found for names in part.values() for n in names})
    return RosState(found, _places(master, nodes, deadline) if nodes else {})


def _places(master: str, nodes: Iterable[str], deadline: Deadline) -> dict[str, str]:
    """Raises OSError."""
    names = list(nodes)
    calls = [{"methodName": "lookupNode", "params": [CALLER, node]} for node in names]
    answers = ask(master, "system.multicall", calls, deadline=deadline)
    if not (isinstance(answers, list) and len(answers) == len(names)):
        raise OSError("its answer is not that of a ROS master")
    return {node: uri for node, said in zip(names, answers, strict=True) if (uri := _place(said))}


def _place(said: Any) -> str:
    """Of one answer among several, which comes in a list of its own; empty where it is none."""
    try:
        return str(value_of(said[0])) if isinstance(said, list) and len(said) == 1 else ""
    except (LookupError, OSError):
        return ""


def refuses(uri: str) -> bool:
    """Whether nobody is there: the connection is refused. A paused program accepts it, and what does not answer in
    time may be anything."""
    try:
        connect(*place_of(uri), Deadline.within(TIMEOUT)).close()
    except ConnectionRefusedError:
        return True
    except OSError:
        pass
    return False


def unregister(master: str, node: str, state: RosState) -> None:
    """Takes out what this node has registered from the place that the state says; what it, or another of its name, has
    registered from another place since stays. Raises OSError; LookupError when the master knows it no more."""
    deadline, uri = Deadline.within(READING), state.places[node]
    if call(master, "lookupNode", CALLER, node, deadline=deadline) != uri:
        raise LookupError(f"{node} is at another place by now")
    publishers, subscribers, services = state.graph
    told = [("unregisterPublisher", topic, uri) for topic, names in publishers.items() if node in names]
    told += [("unregisterSubscriber", topic, uri) for topic, names in subscribers.items() if node in names]
    told += [
        ("unregisterService", service, str(call(master, "lookupService", CALLER, service, deadline=deadline)))
        for service, names in services.items()
        if node in names
    ]
    for method, name, where in told:
        call(master, method, node, name, where, deadline=deadline)
