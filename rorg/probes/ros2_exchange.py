"""What rorg asks of ROS 2, and what comes back.

rorg has no ROS 2 of its own. A node in the robot's own image reports the graph (`clients/ros2`): it follows the robot's
release and middleware. rorg never calls it. It asks by leaving orders that the reporter fetches, and each answer is to
one order, so that it is about a moment after the question.
"""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

from rorg.core.ros_graph import RosGraph
from rorg.errors import EngineError, Refused
from rorg.model.ros import graph_of_domain
from rorg.probes.answer import Answer, cannot_ask, no

SILENT = 5.0
"""Seconds after which a reporter that has not called counts as gone. It calls every second."""
ASKING = 3.0
"""Seconds that a reporter has for the answer to a probe."""
MARGIN = 1.0
"""Seconds beyond what the reporter has, so that its own reason arrives."""
ACTIVATING, DEACTIVATING = 60.0, 10.0
"""Seconds for the transitions of one node: configuring may load a map."""
Values = Mapping[str, object]


@dataclass(frozen=True, slots=True)
class Order:
    """Something for the reporter to do once."""

    id: str
    kind: str
    """A kind of probe (ROS_KINDS), activate, deactivate, or ros_parameters."""
    target: tuple[str, ...]
    run_age: float = 0.0
    """Seconds since the run began that the question is about; what is older belongs to an earlier run."""
    values: Values = field(default_factory=dict)
    """Parameters to set, by absolute name."""
    timeout: float = ASKING


@dataclass(frozen=True, slots=True)
class State:
    """State of the life cycle of a managed node."""

    label: str
    at: float
    """When the node was asked, by the loop's clock."""


@dataclass(frozen=True, slots=True)
class Report:
    """News from a reporter that answer no order."""

    graph: RosGraph | None = None
    """None if it is as before."""
    states: Mapping[str, State] = field(default_factory=dict)
    """States of the watched nodes that answered. The last state of a node counts until a newer one is known."""


@dataclass(frozen=True, slots=True)
class Orders:
    """For a reporter: the orders that it does not have yet, and all nodes whose state it reports."""

    orders: Sequence[Order]
    watched: tuple[str, ...]


class _Domain:
    """The state of one domain."""

    def __init__(self, now: float) -> None:
        self.reporter = self.session = ""
        """Who reports, and in which run of it."""
        self.called = now
        """When the reporter called last; before that, when rorg began to know of the domain."""
        self.graph: RosGraph | None = None
        self.states: dict[str, State] = {}
        self.watched: tuple[str, ...] = ()
        self.told: tuple[str, ...] | None = None
        """The watched nodes that the reporter knows of."""
        self.waiting: dict[str, Order] = {}
        """Orders that the reporter has not fetched yet."""
        self.open: dict[str, Answer | None] = {}
        """Orders without an answer, and answers that are not taken yet."""


class Ros2Exchange:
    """For several threads. `wake` is called when a graph or a state has changed; times are of `clock`, in seconds."""

    def __init__(self, clock: Callable[[], float], wake: Callable[[], None]) -> None:
        self.clock, self.wake = clock, wake
        self.version = 0
        """Changes with each graph and state."""
        self._domains: dict[int, _Domain] = {}
        self._condition = threading.Condition()
        self._numbers = itertools.count(1)
        self._listeners: dict[object, tuple[int, Callable[[], None]]] = {}
        self._closed = False

    # -- for reporters -----------------------------------------------------------------------------------------

    def report(self, domain: int, reporter: str, session: str, report: Report, answers: Mapping[str, Answer]) -> None:
        """Take what a reporter says. A new session of it takes the place of an earlier one, whose orders have failed.
        Raises Refused while another reporter reports this domain."""
        with self._condition:
            known = self._of(domain)
            if known.reporter not in ("", reporter) and not self._missing(domain, known):
                message = f"{known.reporter} reports it"
                raise Refused(f"report the graph of {graph_of_domain(domain)}", message, "one of the two alone")
            if session != known.session:
                known.reporter, known.session = reporter, session
                known.told, known.graph = None, None
                for id in [i for i, answer in known.open.items() if answer is None and i not in known.waiting]:
                    known.open[id] = cannot_ask("the node that reports the graph was restarted")
            known.called = self.clock()
            known.open.update({id: answer for id, answer in answers.items() if id in known.open})
            changed = report.graph is not None and report.graph != known.graph
            known.graph = report.graph if report.graph is not None else known.graph
            # What a node was asked before its last transition says nothing about its present state.
            newer = {n: s for n, s in report.states.items() if n not in known.states or s.at >= known.states[n].at}
            states = {n: s for n, s in {**known.states, **newer}.items() if n in known.watched}
            changed = changed or _labels(states) != _labels(known.states)
            known.states = states
            self.version += changed
            self._condition.notify_all()
        if changed:
            self.wake()

    def orders(self, domain: int, session: str) -> Orders | None:
        """Return what the reporter does not know yet; None if there is nothing new."""
        with self._condition:
            known = self._of(domain)
            known.called = self.clock()
            if session != known.session or (not known.waiting and known.told == known.watched):
                return None
            orders, known.waiting, known.told = tuple(known.waiting.values()), {}, known.watched
            return Orders(orders, known.watched)

    def has_graph(self, domain: int, session: str) -> bool:
        """Return whether a session has reported its graph."""
        with self._condition:
            known = self._of(domain)
            return known.session == session and known.graph is not None

    @contextmanager
    def listening(self, domain: int, call: Callable[[], None]) -> Iterator[None]:
        """While the block runs, `call` is called when there may be orders."""
        key = object()
        with self._condition:
            self._listeners[key] = domain, call
        try:
            yield
        finally:
            with self._condition:
                del self._listeners[key]

    # -- for the loop and what works beside it -------------------------------------------------------------------

    def ask(
        self,
        domain: int,
        kind: str,
        target: Sequence[str],
        *,
        run_age: float = 0.0,
        values: Values | None = None,
        timeout: float = ASKING,
    ) -> Answer:
        """Leave an order, and wait for its answer."""
        with self._condition:
            known = self._of(domain)
            if why := self._missing(domain, known):
                return cannot_ask(why)
            order = Order(f"{next(self._numbers)}", kind, tuple(target), run_age, values or {}, timeout)
            known.waiting[order.id], known.open[order.id] = order, None
            self._tell(domain)
            patience = timeout + MARGIN
            answered = self._condition.wait_for(lambda: known.open[order.id] is not None or self._closed, patience)
            known.waiting.pop(order.id, None)
            answer = known.open.pop(order.id)
        if answer is not None:
            return answer
        return cannot_ask("rorg is being stopped" if answered else "the node that reports the graph does not answer")

    def activate(self, container: str, domain: int, nodes: Sequence[str]) -> None:  # noqa: ARG002
        """Bring managed nodes to work; they are known by their names. Raises EngineError."""
        self._change(domain, "activate", nodes, "active", ACTIVATING)

    def deactivate(self, container: str, domain: int, nodes: Sequence[str]) -> None:  # noqa: ARG002
        """Bring managed nodes to rest. Raises EngineError."""
        self._change(domain, "deactivate", nodes, "inactive", DEACTIVATING)

    def _change(self, domain: int, kind: str, nodes: Sequence[str], label: str, timeout: float) -> None:
        answer = self.ask(domain, kind, nodes, timeout=timeout * len(nodes))
        if not answer.ok:
            what = f"{kind} {', '.join(nodes)}"
            raise EngineError(what, answer.message.removeprefix("cannot ask: "), kind="conflict")
        with self._condition:
            known, now = self._of(domain), self.clock()
            known.states |= {node: State(label, now) for node in nodes}
            self.version += 1

    def watch(self, nodes: Mapping[int, tuple[str, ...]]) -> None:
        """From now on, have the states of these nodes reported."""
        with self._condition:
            for domain in {*nodes, *self._domains}:
                known = self._of(domain)
                if (wanted := nodes.get(domain, ())) != known.watched:
                    known.watched = wanted
                    self._tell(domain)

    def graphs(self) -> dict[int, RosGraph]:
        """Return the graph of each domain whose reporter is there."""
        with self._condition:
            return {n: d.graph for n, d in self._domains.items() if d.graph is not None and not self._missing(n, d)}

    def states(self, domain: int) -> Mapping[str, State]:
        """Return the states of managed nodes as reported last."""
        with self._condition:
            return {**self._domains[domain].states} if domain in self._domains else {}

    def unreported(self, domains: Iterable[int]) -> dict[int, float]:
        """Return those of these domains whose reporter is not there -> since when."""
        with self._condition:
            return {n: known.called for n in domains if self._missing(n, known := self._of(n))}

    def close(self) -> None:
        """End all waiting."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()
            for domain, _ in list(self._listeners.values()):
                self._tell(domain)

    def _missing(self, domain: int, known: _Domain) -> str:
        if self.clock() - known.called <= SILENT and known.session:
            return ""
        what = f"nothing reports the ROS 2 graph of {graph_of_domain(domain)}"
        return what if not known.session else f"{what} since {self.clock() - known.called:.0f} s"

    def _of(self, domain: int) -> _Domain:
        return self._domains.setdefault(domain, _Domain(self.clock()))

    def _tell(self, domain: int) -> None:
        for listened, call in list(self._listeners.values()):
            if listened == domain:
                call()


def _labels(states: Mapping[str, State]) -> dict[str, str]:
    return {node: state.label for node, state in states.items()}


def answer_of(ok: bool, message: str, asked: bool) -> Answer:
    """Return what a reporter answered."""
    return Answer(True) if ok else no(message) if asked else cannot_ask(message)
