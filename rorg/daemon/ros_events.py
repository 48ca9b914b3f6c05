"""Tells what the graph of ROS 1 shows: once, when it is first seen."""

from __future__ import annotations

from collections.abc import Callable

from rorg.core.decide import Decision
from rorg.core.pausing import risks
from rorg.core.ros_graph import Takeover


class RosEvents:
    """`event` writes one down: its kind, its text, and the service that it is about."""

    def __init__(self, event: Callable[..., None]) -> None:
        self.event = event
        self._risks: set[tuple[str, str]] = set()
        """(Service, code) that were told: what pausing one does depends on who else is wanted, so it comes and goes."""
        self._takeovers: frozenset[Takeover] = frozenset()

    def tell(self, decision: Decision) -> None:
        """What is new in a pass. A graph, and who is wanted, concern all services: no other pass has anything new."""
        situation = decision.situation
        if not decision.whole or not (situation.ros or self._takeovers):
            return
        for service in situation.desired.catalog.services.values():
            for risk in risks(situation, service):
                if (service.name, risk.code) not in self._risks:
                    self._risks.add((service.name, risk.code))
                    text = f"pausing {service.name} is not safe: {risk.message}"
                    self.event("pause-risk", text, service=service.name, cause=risk.code)
        found = frozenset(takeover for graph in situation.ros.values() for takeover in graph.takeovers)
        for takeover in sorted(found - self._takeovers, key=str):
            services = [takeover.former, takeover.service]
            self.event("ros-node-taken-over", str(takeover), node=takeover.node, services=services)
        self._takeovers = found
