"""Calls of the services that nodes have: bounded in time, and from any thread."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
import contextlib
import threading
import time
from typing import Any

from rcl_interfaces.srv import GetParameters, GetParameterTypes, SetParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import Parameter
from rorg_ros2.answer import Answer

# Seconds for the answer of a node that is well.
PROMPT = 0.8
SETTING = 2.0
POLL = 0.01


class NoAnswer(Exception):
    """The service is not there, or did not answer in time."""


class Calls:
    """The clients of one node, one for each service that it has called."""

    def __init__(self, node: Node) -> None:
        self.node = node
        self._clients: dict[str, Client] = {}
        # How many calls use each client at present.
        self._uses: Counter[str] = Counter()
        self._lock = threading.Lock()

    def call(self, kind: Any, name: str, request: Any, seconds: float = PROMPT) -> Any:
        """Call a service. Raise NoAnswer."""
        end = time.monotonic() + seconds
        with self.client(kind, name) as client:
            while not client.service_is_ready():
                if time.monotonic() > end:
                    raise NoAnswer(f'{name} is not there')
                time.sleep(POLL)
            answered = threading.Event()
            future = client.call_async(request)
            future.add_done_callback(lambda _: answered.set())
            if not answered.wait(max(0.0, end - time.monotonic())):
                client.remove_pending_request(future)
                raise NoAnswer(f'{name} does not answer')
            return future.result()

    def call_all(
        self, kind: Any, names: Sequence[str], request: Any, seconds: float
    ) -> dict[str, Any]:
        """Call many services at the same time. Return the answers that came, by service."""
        end, asked, answers = time.monotonic() + seconds, {}, {}
        with contextlib.ExitStack() as stack:
            for name in names:
                client = stack.enter_context(self.client(kind, name))
                if client.service_is_ready():
                    asked[name] = client, client.call_async(request)
            while asked and time.monotonic() < end:
                time.sleep(POLL)
                for name in [name for name, (_, future) in asked.items() if future.done()]:
                    answers[name] = asked.pop(name)[1].result()
            for client, future in asked.values():
                client.remove_pending_request(future)
        return answers

    def keep(self, nodes: Collection[str]) -> None:
        """Drop the clients for nodes that are not in the graph, except those of calls that run."""
        with self._lock:
            gone = [
                name
                for name in self._clients
                if name.rpartition('/')[0] not in nodes and not self._uses[name]
            ]
            for name in gone:
                self.node.destroy_client(self._clients.pop(name))
                del self._uses[name]

    def ping(self, node: str) -> str:
        """Say why a node does not answer; '' if it does."""
        try:
            self.call(
                GetParameterTypes, f'{node}/get_parameter_types', GetParameterTypes.Request()
            )
        except NoAnswer:
            return f'{node} does not answer'
        return ''

    def is_set(self, name: str) -> Answer:
        """Say whether a parameter is set; the last part of its name is the parameter."""
        node, _, parameter = name.rpartition('/')
        try:
            request = GetParameters.Request(names=[parameter])
            values = self.call(GetParameters, f'{node}/get_parameters', request).values
        except NoAnswer:
            return Answer(False, f'{node} does not answer')
        if values and values[0].type != Parameter.Type.NOT_SET.value:
            return Answer(True)
        return Answer(False, f'{name} is not set')

    def set_parameters(self, values: dict[str, Any]) -> Answer:
        """Set parameters, by absolute name."""
        by_node: dict[str, list[Parameter]] = {}
        for name, value in values.items():
            node, _, parameter = name.rpartition('/')
            flat = [Parameter(n, value=v) for n, v in _flat(parameter, value)]
            by_node.setdefault(node, []).extend(flat)
        for node, parameters in by_node.items():
            messages = [parameter.to_parameter_msg() for parameter in parameters]
            request = SetParameters.Request(parameters=messages)
            try:
                results = self.call(
                    SetParameters, f'{node}/set_parameters', request, SETTING
                ).results
            except NoAnswer:
                return Answer(False, f'{node} does not answer')
            for parameter, result in zip(parameters, results, strict=True):
                if not result.successful:
                    why = result.reason or 'without a reason'
                    return Answer(False, f'{node} refuses {parameter.name}: {why}')
        return Answer(True)

    @contextlib.contextmanager
    def client(self, kind: Any, name: str) -> Iterator[Client]:
        """Give the client of a service, which stays as long as it is used."""
        with self._lock:
            if name not in self._clients:
                self._clients[name] = self.node.create_client(kind, name)
            client = self._clients[name]
            self._uses[name] += 1
        try:
            yield client
        finally:
            with self._lock:
                self._uses[name] -= 1


def _flat(name: str, value: Any) -> Iterable[tuple[str, Any]]:
    """Name the values in a mapping as ROS 2 does: with dots."""
    if not isinstance(value, dict):
        return [(name, value)]
    return [pair for key, inner in value.items() for pair in _flat(f'{name}.{key}', inner)]
