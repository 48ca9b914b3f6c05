"""Managed nodes: their states, and the transitions that bring them to work and to rest."""

from __future__ import annotations

from collections.abc import Sequence
import time

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rorg_ros2.answer import Answer
from rorg_ros2.calls import Calls, NoAnswer

GET = '/get_state'
LABELS = ('unconfigured', 'inactive', 'active', 'finalized')
# Seconds for the answers of all watched nodes.
ALL = 0.8
# Seconds in which nodes that have begun find each other; until then an answer may be lost.
FOUND = 3.0


class Lifecycles:
    """The managed nodes of one domain."""

    def __init__(self, calls: Calls) -> None:
        self.calls = calls

    def state(self, node: str) -> str:
        """Ask one node for its state. Raise NoAnswer."""
        return _label(self.calls.call(GetState, f'{node}{GET}', GetState.Request()))

    def states(self, nodes: Sequence[str]) -> dict[str, str]:
        """Ask many nodes beside each other; those that do not answer are left out."""
        names = [f'{node}{GET}' for node in nodes]
        told = self.calls.call_all(GetState, names, GetState.Request(), ALL)
        return {name.removesuffix(GET): _label(answer) for name, answer in told.items()}

    def activate(self, nodes: Sequence[str], seconds: float) -> Answer:
        """Configure and activate nodes in this order, with so many seconds for each."""
        for node in nodes:
            done = self._lead(node, 'active', seconds)
            if not done.ok:
                return done
        return Answer(True)

    def deactivate(self, nodes: Sequence[str], seconds: float) -> Answer:
        """Deactivate nodes in this order; those that are not active stay as they are."""
        for node in nodes:
            done = self._lead(node, 'inactive', seconds)
            if not done.ok:
                return done
        return Answer(True)

    def _lead(self, node: str, goal: str, seconds: float) -> Answer:
        """Take the transitions from the present state of a node to the goal."""
        end, ways, change = time.monotonic() + seconds, WAYS[goal], f'{node}/change_state'
        try:
            # A client that is there before it is needed, so that the node has found it by then.
            with self.calls.client(ChangeState, change):
                state = self._found(node)
            while state in ways:
                name, transition, leads_to = ways[state]
                request = ChangeState.Request(transition=Transition(id=transition))
                left = max(0.1, end - time.monotonic())
                if not self.calls.call(ChangeState, change, request, left).success:
                    return Answer(False, f'{node} failed to {name}, and is {self.state(node)} now')
                state = leads_to
        except NoAnswer as error:
            return Answer(False, f'{node}: {error}')
        if goal == 'active' and state != 'active':
            return Answer(
                False, f'{node} is {state}, which no transition leads out of; restart it'
            )
        return Answer(True)

    def _found(self, node: str) -> str:
        """Ask a node for its state until it answers. Raise NoAnswer."""
        end = time.monotonic() + FOUND
        while True:
            try:
                return self.state(node)
            except NoAnswer:
                if time.monotonic() > end:
                    raise


# Goal -> state -> the transition to take: its name, its number, and the state that it leads to.
WAYS = {
    'active': {
        'unconfigured': ('configure', Transition.TRANSITION_CONFIGURE, 'inactive'),
        'inactive': ('activate', Transition.TRANSITION_ACTIVATE, 'active'),
    },
    'inactive': {'active': ('deactivate', Transition.TRANSITION_DEACTIVATE, 'inactive')},
}


def state_of(lifecycles: Lifecycles, node: str, wanted: str) -> Answer:
    """Say whether a node is in a state."""
    try:
        state = lifecycles.state(node)
    except NoAnswer:
        return Answer(False, f'node {node} does not answer (lifecycle)')
    return (
        Answer(True) if state == wanted else Answer(False, f'node {node} is {state} (lifecycle)')
    )


def _label(told: GetState.Response) -> str:
    label = told.current_state.label
    return label if label in LABELS else 'other'
