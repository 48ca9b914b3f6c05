"""Probes: whether nodes, publishers, messages, services, actions and parameters are there."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
import importlib
import threading
import time
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rorg_ros2.answer import Answer
from rorg_ros2.calls import Calls
from rorg_ros2.graph import full_name

# Seconds for which messages of a topic are counted after the last question about them.
COUNTED = 15.0
# Seconds over which messages are counted, at least.
WINDOW = 1.0
# Messages that a slow topic must have in the time over which it is counted.
FEW = 3
# Topics whose publishers are remembered.
MOST = 1000
# The name of a node that was paused for longer than its lease: it is back, without its name.
LOST = '_NODE_NAME_UNKNOWN_'
ACTION = '/_action/send_goal'


class Questions:
    """
    Answers probes about one domain.

    DDS shows a killed program for its lease, 20 s by default. So a node must answer a call, and a
    publisher that was there before a run began does not count for it.
    """

    def __init__(self, node: Node, calls: Calls) -> None:
        self.node, self.calls = node, calls
        self._lock = threading.Lock()
        # Topic -> publisher -> when it was first seen.
        self._publishers: dict[str, dict[bytes, float]] = {}
        self._counters: dict[str, _Counter] = {}

    def answer(self, kind: str, target: Sequence[str], since: float, timeout: float) -> Answer:
        """Answer one probe about a run that began at `since` (monotonic)."""
        self._forget()
        if kind == 'ros_node':
            return self._node(target[0])
        if kind == 'ros_topic':
            return self._topic(target[0], since)
        if kind == 'ros_rate':
            return self._rate(target[0], float(target[1]), since, timeout)
        if kind == 'ros_service':
            return self._provider(target[0], target[0], 'service')
        if kind == 'ros_action':
            return self._provider(target[0], target[0] + ACTION, 'action server')
        if kind == 'ros_parameter':
            return self.calls.is_set(target[0])
        return Answer(False, f'this node does not know the probe {kind}; update it', asked=False)

    def _node(self, name: str) -> Answer:
        problem = self.calls.ping(name)
        if problem and name not in self._nodes():
            return Answer(False, f'no node {name}')
        return _of(problem)

    def _topic(self, topic: str, since: float) -> Answer:
        """Whether a node that answers publishes it, by a publisher of this run."""
        known, now = self._publishers_of(topic), time.monotonic()
        names = set()
        found = self.node.get_publishers_info_by_topic(topic)
        for publisher in found:
            gid = bytes(publisher.endpoint_gid)
            if known.setdefault(gid, now) >= since:
                names.add(full_name(publisher.node_name, publisher.node_namespace))
        for gid in known.keys() - {bytes(publisher.endpoint_gid) for publisher in found}:
            del known[gid]
        if not names:
            return Answer(
                False, f'{topic} has no publisher' + (' of this run yet' if found else '')
            )
        return self._any(names)

    def _publishers_of(self, topic: str) -> dict[bytes, float]:
        with self._lock:
            known = self._publishers.pop(topic, {})
            self._publishers[topic] = known  # the last one is the one that was asked for last
            while len(self._publishers) > MOST:
                del self._publishers[next(iter(self._publishers))]
            return known

    def _provider(self, name: str, service: str, what: str) -> Answer:
        """Whether a node that answers provides a service."""
        providers = [
            full_name(*node)
            for node in set(self.node.get_node_names_and_namespaces())
            if service in self._services_of(*node)
        ]
        if not providers and service in dict(self.node.get_service_names_and_types()):
            return Answer(True)  # its node has lost its name
        return self._any(providers) if providers else Answer(False, f'no {what} {name}')

    def _services_of(self, name: str, namespace: str) -> set[str]:
        try:
            services = self.node.get_service_names_and_types_by_node(name, namespace)
        except Exception:  # it has left the graph
            return set()
        return {found for found, _ in services}

    def _rate(self, topic: str, hz: float, since: float, timeout: float) -> Answer:
        """Whether enough messages came in the time before now, since the run began."""
        end = time.monotonic() + timeout - 0.5
        counter = self._counter(topic)
        if isinstance(counter, Answer):
            return counter
        window = max(WINDOW, FEW / hz)
        begin = max(counter.since, since)
        while time.monotonic() < begin + window:
            if time.monotonic() > end:
                why = f'the messages of {topic} are still being counted'
                return Answer(False, why, asked=False)
            time.sleep(0.02)
        count = counter.within(window)
        if count + 1 > hz * window:  # the window may begin right after a message
            return Answer(True)
        return Answer(False, f'{topic} has {count / window:.3g} of {hz:g} messages a second')

    def _counter(self, topic: str) -> _Counter | Answer:
        with self._lock:
            if topic not in self._counters:
                types = dict(self.node.get_topic_names_and_types()).get(topic)
                if not types:
                    return Answer(False, f'{topic} has no publisher')
                kind = _message(types[0])
                if kind is None:
                    return Answer(
                        False, f'{types[0]} is not in the image of rorg_ros2', asked=False
                    )
                self._counters[topic] = _Counter(self.node, kind, topic)
            counter = self._counters[topic]
            counter.asked = time.monotonic()
            return counter

    def _forget(self) -> None:
        """End counting what nobody asks for any more."""
        with self._lock:
            now = time.monotonic()
            old = [t for t, counter in self._counters.items() if counter.asked + COUNTED < now]
            for topic in old:
                self._counters.pop(topic).close()

    def _nodes(self) -> set[str]:
        return {full_name(*node) for node in self.node.get_node_names_and_namespaces()}

    def _any(self, nodes: Iterable[str]) -> Answer:
        """Whether one of these nodes answers."""
        problems = []
        for node in sorted(nodes):
            problem = self.calls.ping(node)
            if not problem:
                return Answer(True)
            problems.append(problem)
        return Answer(False, '; '.join(problems))


class _Counter:
    """Counts the messages of a topic, without unpacking them."""

    def __init__(self, node: Node, kind: Any, topic: str) -> None:
        self.node, self.since, self.asked = node, time.monotonic(), 0.0
        self._times: deque[float] = deque(maxlen=100_000)
        # Such a subscription gets messages from every publisher.
        qos = QoSProfile(
            depth=100,
            reliability=ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.VOLATILE,
        )
        self._subscription = node.create_subscription(kind, topic, self._count, qos, raw=True)

    def _count(self, _: bytes) -> None:
        self._times.append(time.monotonic())

    def within(self, seconds: float) -> int:
        begin = time.monotonic() - seconds
        return sum(1 for at in tuple(self._times) if at >= begin)

    def close(self) -> None:
        self.node.destroy_subscription(self._subscription)


def _of(problem: str) -> Answer:
    return Answer(False, problem) if problem else Answer(True)


def _message(name: str) -> Any:
    """Find the class of a type such as std_msgs/msg/String; None if this image lacks it."""
    package, _, kind = name.replace('/', '.').rpartition('.')
    try:
        return getattr(importlib.import_module(package), kind, None)
    except ImportError:
        return None
