"""Taking the robot down: nothing is requested any more, and everything of rorg's may be removed."""

from __future__ import annotations

from dataclasses import replace

from rorg.core.decide import Decision
from rorg.core.desired import Desired, teardown
from rorg.core.inputs import Inputs
from rorg.core.memory import STALLED_AFTER
from rorg.core.observed import Container
from rorg.model.objects import is_object
from rorg.store.requests_document import RequestsDocument


class Teardown:
    """The state that a robot which is taken down should reach. Made once for each tree."""

    def __init__(self) -> None:
        self._made: tuple[Desired, Desired] | None = None
        """(what the tree asks for, what is desired instead)."""

    def of(self, inputs: Inputs) -> Inputs:
        """Return the inputs of a pass that takes the robot down."""
        if self._made is None or self._made[0] is not inputs.desired:
            self._made = inputs.desired, teardown(inputs.desired, inputs.memory.kept.catalog)
        # Neither leases of other machines nor their services, whose needs go, keep anything here.
        unknown = dict.fromkeys((*inputs.peers.remotes, *inputs.peers.unknown), "is elsewhere; this machine goes down")
        peers = replace(inputs.peers, requests=(), excluded={}, unowned={}, remotes={}, unknown=unknown)
        return replace(
            inputs, desired=self._made[1], peers=peers, requests=(), restarts={}, holds={}, removals=True, down=True
        )


def is_down(document: RequestsDocument, decision: Decision | None) -> bool:
    """Return whether the robot has been taken down and nothing of it is left. One that was down already when rorg
    started stays down, and the loop with it."""
    if decision is None or not document.down or document.down_since:
        return False
    observed = decision.situation.observed
    # A network whose removal was refused stays, because others use it; so does a container that names no service.
    going = any(is_object(action.service) for action in decision.plan.actions)
    left = any(not _stays(decision, c) for cs in observed.by_service().values() for c in cs)
    return observed.complete and not (left or decision.memory.in_flight or going)


def _stays(decision: Decision, container: Container) -> bool:
    """Return whether the engine does not remove a container, although it does not run."""
    tried = decision.memory.of(container.service).removals.get(container.id)
    failed = tried is not None and bool(tried.error) and tried.count >= STALLED_AFTER
    return not container.alive and (container.state == "removing" or failed)
