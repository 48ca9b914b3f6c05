"""Conditions of a service, each with a reason that programs can go by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rorg.core.backoff import STALLED_AFTER
from rorg.core.memory import Progress
from rorg.core.pausing import risks
from rorg.core.rollout import candidate, has_come_up
from rorg.core.ros_graph import master_of
from rorg.core.situation import Situation
from rorg.core.wanted import Link
from rorg.model.catalog import Service

CAUTIONS = ("Pausable", "NodesUnique")
"""Types of conditions that tell of no trouble yet."""


@dataclass(frozen=True, slots=True)
class Condition:
    """As in Kubernetes: `type` is Ready, Requested, Reconciling or Stalled; Updated beside, where a change failed
    (False: it is quarantined) or is on trial (Unknown: OnTrial until it has come up, then Baking); Pausable, and
    NodesUnique, only where they are False. status is True, False or Unknown."""

    type: str
    status: str
    reason: str
    message: str = ""


def requested(links: Sequence[Link]) -> Condition:
    """Whether something wants it, by the chain that leads to it."""
    text = " <- ".join(map(str, links))
    return Condition("Requested", str(bool(links)), "Wanted" if links else "NotWanted", text)


def occasional(situation: Situation, service: Service) -> tuple[Condition, ...]:
    """Those that are there only where they tell something."""
    return (*_updated(situation, service.name), *_of_ros(situation, service))


def _updated(situation: Situation, name: str) -> tuple[Condition, ...]:
    """How its last change fares, while that is open or has failed."""
    step = situation.memory.of(name)
    containers = situation.observed.by_service().get(name, [])
    if step.update.failed:
        remedy = f"change it again, or `rorg retry {name}`"
        return (Condition("Updated", "False", "Quarantined", f"{step.update.failed}; {remedy}"),)
    if containers and containers[0].active and candidate(containers, step.update):
        service, looked = situation.desired.catalog.services[name], situation.observed.looked.get(containers[0].id)
        up = has_come_up(step, service, looked, situation.now)
        return (Condition("Updated", "Unknown", "Baking" if up else "OnTrial"),)
    return ()


def stalled(step: Progress) -> str:
    """The reason of the condition Stalled."""
    if not step.stalled:
        return "Fine"
    return "CrashLoop" if step.exits >= STALLED_AFTER else "RepeatedFailure"


def _of_ros(situation: Situation, service: Service) -> tuple[Condition, ...]:
    """What the graph of its ROS 1 master says of a service."""
    found = risks(situation, service)
    pausable = [Condition("Pausable", "False", found[0].code, "; ".join(r.message for r in found))] if found else []
    graph = situation.ros.get(master_of(service)) if situation.ros else None
    taken = [t for t in graph.takeovers if service.name in (t.former, t.service)] if graph else []
    shared = [Condition("NodesUnique", "False", "TakenOver", "; ".join(map(str, taken)))] if taken else []
    return (*pausable, *shared)
