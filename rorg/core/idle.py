"""What happens to a service that nothing wants, as its idle policy says: pause, stop or remove. The paper's robot
pauses or stops what is not requested (section III-C). The removal of `action: remove` is in reconcile.py, because then
no container is kept.

Pausing a ROS 1 service affects others: its connections stay open, and so does its registration at the master. Measured:
a paused subscriber receives its whole backlog on resume, up to 30 s old; a publisher with queue_size=None blocks while
its subscriber is paused; service calls to a paused node hang.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from rorg.core.memory import Attempt
from rorg.core.observed import Container
from rorg.core.operations import Deactivate, Operation, Pause
from rorg.core.room import room
from rorg.core.ros_graph import Connection, RosGraph, connections, graph_of
from rorg.core.situation import Situation, View
from rorg.core.steps import Step, away, kill, stop
from rorg.core.wanted import wanted_without
from rorg.model.catalog import Service
from rorg.model.units import format_seconds

OF_EVERY_NODE = ("/get_loggers", "/set_logger_level")
"""ROS services that every node provides; only people call them."""
LATCHED = frozenset(("map", "map_metadata", "robot_description", "tf_static"))
"""Topics that are usually published once, by the last part of their name. The master does not know whether a topic is
latched."""
MOST = 3
"""Names per sentence."""


@dataclass(frozen=True, slots=True)
class InUse:
    """Why a service is not paused although its idle policy says so."""

    connections: tuple[Connection, ...]
    """With nodes that are wanted; empty if its connections are not known."""

    def __str__(self) -> str:
        if not self.connections:
            return "its connections in the ROS graph are not known"
        others = dict.fromkeys((c.service or f"the node {c.other}", c.topic) for c in self.connections)
        return "connected to " + _some([f"{other} by {topic}" for other, topic in others])


def in_use(situation: Situation, service: Service) -> InUse | None:
    """Return the connections that an unwanted service has with nodes of wanted services, or with nodes that belong to
    no known service; None if there are none."""
    graph = situation.ros.get(graph_of(service))
    if graph is None or not graph.of(service.name):
        return InUse(())
    live_connections = tuple(
        c for c in connections(graph, service.name) if not c.service or c.service in situation.wanted
    )
    return InUse(live_connections) if live_connections else None


@dataclass(frozen=True, slots=True)
class Risk:
    """A consequence of pausing a service."""

    code: str
    """PublisherBlocks, CallersHang or LatchedTopicMissed."""
    message: str


def risks(situation: Situation, service: Service) -> tuple[Risk, ...]:
    """Return the risks of a service that is paused when idle, as far as its master knows; worst first."""
    if not situation.engine.pause or service.idle.action != "pause" or service.always_on:
        return ()
    graph = situation.ros.get(graph_of(service))
    if graph is None:
        return ()
    own, unaware = graph.of(service.name), service.idle.connected == "pause"
    all_risks = [
        _blocking(graph, service, wanted_without(situation.wanted, service.name)) if unaware else None,
        _called(_names_of(graph.providers, own)),
        _latched(_names_of(graph.publishers, own)) if unaware else None,
    ]
    return tuple(risk for risk in all_risks if risk)


def _names_of(registered: Mapping[str, Collection[str]], own: frozenset[str]) -> list[str]:
    return sorted(name for name, nodes in registered.items() if not own.isdisjoint(nodes))


def _blocking(graph: RosGraph, service: Service, wanted: Collection[str]) -> Risk | None:
    heard = [c for c in connections(graph, service.name) if c.subscribes and c.service in wanted]
    if not heard:
        return None
    topics, publishers = dict.fromkeys(c.topic for c in heard), dict.fromkeys(c.service for c in heard)
    return Risk(
        "PublisherBlocks",
        f"it subscribes to {_some(topics)} of {_some(publishers)}: a publisher may block while it is paused, and on "
        "resume it receives its whole backlog; try idle: {action: pause, connected: stop}",
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
    message = (
        f"it publishes {_some(topics)}, usually only once: who subscribes while it is paused receives nothing; try "
    )
    return Risk("LatchedTopicMissed", message + "idle: {action: stop}, or add it to the needs of its users")


def _some(names: Iterable[str]) -> str:
    listed = list(names)
    more = [f"{len(listed) - MOST} more"] if len(listed) > MOST else []
    return ", ".join(listed[:MOST]) + "".join(f" and {m}" for m in more)


ATTEMPTS = 2
"""Failed attempts to pause or deactivate after which a service is stopped instead: pausing can fail under load ("unable
to freeze"), and a transition can fail or hang."""
UNREPORTED = 30.0
"""Seconds without a report of the ROS 2 graph after which a service is stopped instead of deactivated. A reporter that
was restarted, or that finds a restarted rorg, is back sooner."""
Ceasing = tuple[list[Step], float | None]
"""Steps, and the time at which the next step is due although nothing waits for it."""


def cease(view: View, service: Service, container: Container) -> Ceasing:
    """Return what to do now with the container of an unwanted service."""
    situation, idle = view.s, service.idle
    why, since = situation.preempted.get(service.name, "not wanted"), situation.memory.of(service.name).ceased_since
    frees = service.name in situation.measures.shed or (container.alive and view.exclusive.contested(service))
    if container.active and idle.keeps_run and not frees:
        return (
            ([_pause(view, service, container, why)], None)
            if idle.action == "pause"
            else _deactivate(view, service, container, why)
        )
    if container.alive and frees:
        return [_end(view, service, container, why)], None
    if container.alive and idle.action == "stop":
        return [stop(container, why, service)], None
    if container.asleep and situation.measures.stop_paused:
        return [_end(view, service, container, "the machine is short of memory")], None
    if container.state == "paused" and (why := _why_not_paused(view, service)):
        return [stop(container, why, service)], None
    if idle.escalate and since is not None:
        return _escalate(view, service, container, since, *idle.escalate)
    return [], None


def _pause(view: View, service: Service, container: Container, why: str) -> Step:
    """Pause, or stop if the engine cannot pause or the pause would affect others: no idle service runs for ever."""
    if not view.s.engine.pause:
        return stop(container, f"{why}; stop instead of pause: the engine cannot pause", service)
    if failed := _failed(view, service, Pause):
        return stop(container, f"{why}; stop instead of pause: {failed}", service)
    use = in_use(view.s, service) if service.idle.connected == "stop" else None
    if use is None:
        return Step(Pause(container=container.id), why)
    return stop(container, f"{why}; stop instead of pause: {use}", service)


def _deactivate(view: View, service: Service, container: Container, why: str) -> Ceasing:
    """Deactivate the managed nodes, or stop the service if a transition fails or hangs, or if for a while nothing
    reports the graph: then rorg has no way to deactivate them."""
    failed, graph = _failed(view, service, Deactivate), graph_of(service)
    if service.domain is None or not service.managed:
        return [stop(container, why, service)], None
    if (since := view.s.unreported.get(graph)) is not None:
        if not view.has_come(since + UNREPORTED):
            return [], since + UNREPORTED
        failed = failed or f"nothing reports the graph of {graph}"
    if failed:
        return [stop(container, f"{why}; stop instead of deactivate: {failed}", service)], None
    return [Step(Deactivate(container=container.id, nodes=service.managed[::-1], domain=service.domain), why)], None


def _failed(view: View, service: Service, kind: type[Operation]) -> str:
    """Return why this kind of operation is not tried again; "" if it may succeed."""
    tried = view.s.memory.of(service.name).attempt(kind) or Attempt()
    return tried.error if tried.unsupported or (tried.count >= ATTEMPTS and not tried.unanswered) else ""


def _end(view: View, service: Service, container: Container, why: str) -> Step:
    """Return the step that ends a run because others need what it holds. If it is paused and has no room to run until
    its end, it is killed: otherwise the others would wait for as long as the room is taken."""
    taken = room(view, service)[1] if container.state == "paused" else None
    return kill(container, f"{why}; killed while paused: {taken.reason}") if taken else stop(container, why, service)


def _why_not_paused(view: View, service: Service) -> str:
    """Return why a paused service must be stopped; "" if it stays as it is."""
    use = in_use(view.s, service) if service.idle.connected == "stop" else None
    # Unknown connections may be the same as when it was paused: leave it paused.
    return f"stop instead of pause: {use}" if use and use.connections else ""


def _escalate(view: View, service: Service, container: Container, since: float, after: float, action: str) -> Ceasing:
    """Take the second, harder step for a service that stays unwanted."""
    if action == "stop" and not container.alive:
        return [], None
    if action == "pause" and container.state != "inactive":
        return [], None
    if not view.has_come(since + after):
        return [], since + after if container.asleep or action == "remove" else None
    why = f"not wanted for {format_seconds(after)}"
    if action == "pause":
        return [_pause(view, service, container, why)], None
    if action == "remove":
        return away(container, why, service, volumes=True), None
    return [stop(container, why, service)], None
