"""
Reports the ROS 2 graph to rorg, and does what rorg asks of it.

rorg has no ROS 2 of its own. Each answer here is about a moment after its question.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
import contextlib
import threading
import time
from typing import Any
import uuid

from rclpy.node import Node
from rorg_client import Client, Error
from rorg_client.errors import Forbidden
from rorg_ros2.answer import Answer
from rorg_ros2.calls import Calls
from rorg_ros2.graph import full_name
from rorg_ros2.lifecycle import Lifecycles, state_of
from rorg_ros2.questions import Questions

# Seconds between two calls of rorg. It counts a reporter that is silent for 5 s as gone.
EVERY = 1.0
# Seconds between two looks at the graph; a look that finds nothing new takes a millisecond.
LOOK = 0.25
# Seconds after which everything is read again, whether it seems new or not.
WHOLE = 10.0
# Seconds for which answers are gathered.
GATHER = 0.002
# Orders that are carried out at the same time.
MOST = 32
# Topics and services that every node has.
OF_EVERY_NODE = (
    *('/rosout', '/parameter_events', '/describe_parameters', '/get_parameter_types'),
    *('/get_parameters', '/list_parameters', '/set_parameters', '/set_parameters_atomically'),
    '/get_type_description',
)


class Reporter:
    """Works in threads of its own, for as long as the node's context is valid."""

    def __init__(self, node: Node, new_client: Callable[[], Client], domain: int) -> None:
        self.node, self.path = node, f'/v1/ros2/{domain}'
        self.new_client, self.session = new_client, str(uuid.uuid4())
        self.calls = Calls(node)
        self.lifecycles, self.questions = Lifecycles(self.calls), Questions(node, self.calls)
        self._sending = new_client()
        self._pool = ThreadPoolExecutor(MOST, thread_name_prefix='order')
        self._graph: dict[str, Any] = {}
        # The graph that rorg has.
        self._told: dict[str, Any] | None = None
        self._watched: list[str] = []
        # When managed nodes were asked last, and their states.
        self._states: tuple[float, dict[str, str]] = (0.0, {})
        # Managed nodes are to be asked now.
        self._turn = threading.Event()
        # There is something to report now: answers by the ids of their orders, or a change.
        self._news = threading.Event()
        self._answers: deque[tuple[str, dict[str, Any]]] = deque()

    def start(self) -> None:
        for work in (self._fetch, self._send, self._look, self._watch):
            threading.Thread(target=self._while_up, args=(work,), daemon=True).start()

    # -- what is reported ------------------------------------------------------------------------

    def _look(self) -> None:
        """Read the graph if anything has changed."""
        seen, at = None, -WHOLE
        while self.node.context.ok():
            now = _outline(self.node)
            if now != seen or time.monotonic() > at + WHOLE:
                graph, at = read_graph(self.node), time.monotonic()
                if graph != self._graph:
                    self._graph = graph
                    self.calls.keep(graph['nodes'])
                    self._turn.set()
                    self._news.set()
                seen = now
            time.sleep(LOOK)

    def _watch(self) -> None:
        """Ask managed nodes for their states: when the graph has changed, and now and then."""
        while self.node.context.ok():
            self._turn.wait(EVERY)
            self._turn.clear()
            if self._watched:
                began, before = time.monotonic(), self._states[1]
                self._states = began, self.lifecycles.states(self._watched)
                if self._states[1] != before:
                    self._news.set()

    def _report(self, answers: dict[str, Any]) -> dict[str, Any]:
        graph, (asked, states) = self._graph or None, self._states
        age = time.monotonic() - asked
        return {
            'session': self.session,
            'graph': None if graph == self._told else graph,
            'states': {node: {'label': label, 'age': age} for node, label in states.items()},
            'answers': answers,
        }

    def _send(self) -> None:
        """Report whenever there is something new; answers that come together go together."""
        while self.node.context.ok():
            self._news.wait()
            time.sleep(GATHER)
            self._news.clear()
            answers = {}
            while self._answers:
                answers.update([self._answers.popleft()])
            body = self._report(answers)
            self._take(self._sending.call('POST', self.path, body), body)

    # -- what is asked ---------------------------------------------------------------------------

    def _fetch(self) -> None:
        """Fetch orders, and carry them out beside each other."""
        client = self.new_client()
        while self.node.context.ok():
            body = self._report({})
            self._take(client.call('POST', f'{self.path}?wait={EVERY}', body), body)

    def _take(self, told: dict[str, Any], body: dict[str, Any]) -> None:
        sent = body['graph'] if body['graph'] is not None else self._told
        self._told = sent if told['graph'] else None  # a restarted rorg has none
        if told['watched'] is not None:
            self._watched = told['watched']
            self._turn.set()
        for order in told['orders']:
            self._pool.submit(self._carry_out, order)

    def _carry_out(self, order: dict[str, Any]) -> None:
        try:
            answer = self._answer(order)
        except Exception as error:  # whatever a middleware raises: rorg must have an answer
            answer = Answer(False, f'{type(error).__name__}: {error}', asked=False)
        self._answers.append((order['id'], answer.as_json()))
        self._news.set()

    def _answer(self, order: dict[str, Any]) -> Answer:
        kind, target, timeout = order['kind'], order['target'], order['timeout']
        if kind in ('activate', 'deactivate'):
            change = self.lifecycles.activate if kind == 'activate' else self.lifecycles.deactivate
            return change(target, timeout / max(1, len(target)))
        if kind == 'lifecycle':
            return state_of(self.lifecycles, *target)
        if kind == 'ros_parameters':
            return self.calls.set_parameters(order['values'])
        return self.questions.answer(kind, target, time.monotonic() - order['run_age'], timeout)

    # -- threads ---------------------------------------------------------------------------------

    def _while_up(self, work: Callable[[], None]) -> None:
        """Do some work again and again; rorg may be away, and the node may be shut down."""
        while self.node.context.ok():
            try:
                return work()
            except Forbidden as error:
                self.node.get_logger().info(f'does not report the graph: {error}', once=True)
                time.sleep(WHOLE)
            except Error as error:
                self._told = None
                self.node.get_logger().warning(str(error), throttle_duration_sec=10)
                time.sleep(EVERY)
            except Exception:
                if self.node.context.ok():
                    raise


def _outline(node: Node) -> tuple[Any, ...]:
    """What changes with nearly every change of the graph, at little cost."""
    return (
        sorted(node.get_node_names_and_namespaces()),
        sorted((name, len(types)) for name, types in node.get_topic_names_and_types()),
        sorted((name, len(types)) for name, types in node.get_service_names_and_types()),
        [node.count_publishers(name) for name, _ in node.get_topic_names_and_types()],
    )


def read_graph(node: Node) -> dict[str, Any]:
    """Read the whole graph, as the API of rorg takes it."""
    graph: dict[str, Any] = {'nodes': []}
    asks = (
        ('publishers', node.get_publisher_names_and_types_by_node),
        ('subscribers', node.get_subscriber_names_and_types_by_node),
        ('providers', node.get_service_names_and_types_by_node),
        ('callers', node.get_client_names_and_types_by_node),
    )
    graph.update((end, {}) for end, _ in asks)
    for name, namespace in sorted(set(node.get_node_names_and_namespaces())):
        full = full_name(name, namespace)
        graph['nodes'].append(full)
        for end, ask in asks:
            for found in _names(ask, name, namespace):
                graph[end].setdefault(found, []).append(full)
    return graph


def _names(ask: Callable[..., Any], name: str, namespace: str) -> Iterator[str]:
    with contextlib.suppress(Exception):  # the node is gone, or its name is none
        for found, _ in ask(name, namespace):
            if not found.endswith(OF_EVERY_NODE):
                yield found
