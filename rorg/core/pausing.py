"""What it does to others when a service of ROS 1 is paused: its connections stay, and whoever is at their other end
waits for it, or misses it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from rorg.core.ros_graph import Connection, RosGraph, connections, master_of
from rorg.core.situation import Situation
from rorg.core.wanted import wanted_without
from rorg.model.catalog import Service

OF_EVERY_NODE = ("/get_loggers", "/set_logger_level")
"""Services that each node provides, and people call."""
LATCHED = frozenset(("map", "map_metadata", "robot_description", "tf_static"))
"""Topics that are published once, as a rule, by the last word of their names: the master does not say of a topic
whether it is latched."""
MOST = 3
"""Names in one sentence."""


@dataclass(frozen=True, slots=True)
class InUse:
    """Why a service is not paused though that is its idle action."""

    connections: tuple[Connection, ...]
    """With nodes that somebody wants; empty where it is not known what it is connected to."""

    def __str__(self) -> str:
        if not self.connections:
            return "its connections in the ROS graph are not known"
        others = dict.fromkeys((c.service or f"the node {c.other}", c.topic) for c in self.connections)
        return "connected to " + _some([f"{other} by {topic}" for other, topic in others])


def in_use(situation: Situation, service: Service) -> InUse | None:
    """Whether nodes of wanted services, or nodes that no service of this robot is known to run, are connected to those
    of a service that nobody wants. None where none is."""
    graph = situation.ros.get(master_of(service))
    if graph is None or not graph.of(service.name):
        return InUse(())
    found = tuple(c for c in connections(graph, service.name) if not c.service or c.service in situation.wanted)
    return InUse(found) if found else None


@dataclass(frozen=True, slots=True)
class Risk:
    """What comes of pausing a service."""

    code: str
    """PublisherBlocks, CallersHang or LatchedTopicMissed."""
    message: str


def risks(situation: Situation, service: Service) -> tuple[Risk, ...]:
    """Of a service that is paused when nobody wants it, as far as its master knows; worst first."""
    if not (situation.ros and situation.engine.pause) or service.idle.action != "pause" or service.always_on:
        return ()
    graph = situation.ros.get(master_of(service))
    if graph is None:
        return ()
    own, unaware = graph.of(service.name), service.idle.connected == "pause"
    found = [
        _blocking(graph, service, wanted_without(situation.wanted, service.name)) if unaware else None,
        _called(_names_of(graph.providers, own)),
        _latched(_names_of(graph.publishers, own)) if unaware else None,
    ]
    return tuple(risk for risk in found if risk)


def _names_of(registered: Mapping[str, Collection[str]], own: frozenset[str]) -> list[str]:
    return sorted(name for name, nodes in registered.items() if not own.isdisjoint(nodes))


def _blocking(graph: RosGraph, service: Service, wanted: Collection[str]) -> Risk | None:
    heard = [c for c in connections(graph, service.name) if c.subscribes and c.service in wanted]
    if not heard:
        return None
    topics, publishers = dict.fromkeys(c.topic for c in heard), dict.fromkeys(c.service for c in heard)
    return Risk(
        "PublisherBlocks",
        f"it subscribes to {_some(topics)} of {_some(publishers)}: a publisher may block while it is paused, and when "
        "it is resumed it gets what came meanwhile; try idle: {action: pause, connected: stop}",
    )


def _called(provided: Iterable[str]) -> Risk | None:
    services = [name for name in provided if not name.endswith(OF_EVERY_NODE)]
    if not services:
        return None
    message = f"it provides {_some(services)}: callers hang while it is paused; try idle: {{action: stop}}"
    return Risk("CallersHang", message)


def _latched(published: Iterable[str]) -> Risk | None:
    topics = [name for name in published if name.rpartition("/")[2] in LATCHED]
    if not topics:
        return None
    message = f"it publishes {_some(topics)}, once as a rule: who comes while it is paused does not get that; try "
    return Risk("LatchedTopicMissed", message + "idle: {action: stop}, or needs of those that use it")


def _some(names: Iterable[str]) -> str:
    found = list(names)
    more = [f"{len(found) - MOST} more"] if len(found) > MOST else []
    return ", ".join(found[:MOST]) + "".join(f" and {m}" for m in more)
