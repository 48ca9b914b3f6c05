"""Conditions of a service, in the form that Kubernetes uses: a type, a status and a machine-readable reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rorg.core.idle import risks
from rorg.core.memory import STALLED_AFTER, Progress
from rorg.core.plan import Action
from rorg.core.probes_in_force import is_live_untried, is_ready_untried
from rorg.core.rollout import has_come_up
from rorg.core.ros_graph import graph_of
from rorg.core.situation import Situation
from rorg.core.trial import candidate
from rorg.core.wanted import Link
from rorg.model.catalog import Service
from rorg.model.machines import ANYWHERE

CAUTIONS = ("Pausable", "NodesUnique", "RunsOnce")
"""Condition types that warn of a risk while nothing is wrong yet."""


@dataclass(frozen=True, slots=True)
class Condition:
    """`type` is one of:

    - Ready, Requested, Reconciling, Stalled: always present;
    - Updated, if a change failed (False: quarantined) or is on trial (Unknown: OnTrial until it has come up, then
      Baking);
    - Pausable, NodesUnique and RunsOnce, only if they are False;
    - Cleared, only if it is False: the engine does not remove a container that is over.

    `status` is True, False or Unknown.
    """

    type: str
    status: str
    reason: str
    message: str = ""


def requested(links: Sequence[Link]) -> Condition:
    """Return whether something wants the service, with the chain that leads to it as the message."""
    text = " <- ".join(map(str, links))
    return Condition("Requested", str(bool(links)), "Wanted" if links else "NotWanted", text)


def reconciling(actions: Sequence[Action], waiting: str) -> Condition:
    """Return whether anything is under way or planned, and what waits."""
    verb = actions[0].verb.capitalize() if actions else "Settled"
    return Condition("Reconciling", str(bool(actions)), verb, waiting)


def occasional(situation: Situation, service: Service, not_removed: str) -> tuple[Condition, ...]:
    """Return the conditions that are present only if they have something to report. `not_removed` says which container
    the engine does not remove; "" if there is none."""
    found = *_updated(situation, service.name), *_ros_conditions(situation, service), *runs_once(situation, service)
    return (*found, Condition("Cleared", "False", "NotRemoved", not_removed)) if not_removed else found


def runs_once(situation: Situation, service: Service) -> tuple[Condition, ...]:
    """Return whether a service that may run anywhere can run twice, and where it runs as far as that is known."""
    if service.machine != ANYWHERE or service.name not in situation.wanted:
        return ()
    current = situation.observed.current(service.name)
    node = f"it runs on {current.node}; " if current and current.node and current.alive else ""
    if node and current and current.state == "running" and current.error:
        return (Condition("RunsOnce", "False", "NodeLost", f"{node}{current.error}"),)
    return (
        Condition("RunsOnce", "False", "Swarm", f"{node}while the network of the Swarm is split, it may run twice"),
    )


def _updated(situation: Situation, name: str) -> tuple[Condition, ...]:
    """Return the state of the last change while it is on trial or after it failed."""
    progress = situation.memory.of(name)
    containers = situation.observed.of(name)
    if progress.update.failed:
        remedy = f"change it again, or `rorg retry {name}`"
        return (Condition("Updated", "False", "Quarantined", f"{progress.update.failed}; {remedy}"),)
    service, current = situation.desired.catalog.services[name], containers[0] if containers else None
    if any(untried(service, progress.update, current) for untried in (is_ready_untried, is_live_untried)):
        return (Condition("Updated", "Unknown", "Baking", "its new probe is being tried"),)
    if current and current.active and candidate(containers, progress.update):
        looked = situation.observed.looked.get(current.id)
        up = has_come_up(progress, service, looked, situation.now)
        return (Condition("Updated", "Unknown", "Baking" if up else "OnTrial"),)
    return ()


def stalled(progress: Progress) -> str:
    """Return the reason for the condition Stalled."""
    if not progress.stalled:
        return "Fine"
    return "CrashLoop" if progress.exits >= STALLED_AFTER else "RepeatedFailure"


def _ros_conditions(situation: Situation, service: Service) -> tuple[Condition, ...]:
    """Return conditions found in the graph of the service's ROS 1 master."""
    pause_risks = risks(situation, service)
    pausable = (
        [Condition("Pausable", "False", pause_risks[0].code, "; ".join(r.message for r in pause_risks))]
        if pause_risks
        else []
    )
    graph = situation.ros.get(graph_of(service)) if situation.ros else None
    taken = [t for t in graph.takeovers if service.name in (t.former, t.service)] if graph else []
    shared = [Condition("NodesUnique", "False", "TakenOver", "; ".join(map(str, taken)))] if taken else []
    return (*pausable, *shared)
