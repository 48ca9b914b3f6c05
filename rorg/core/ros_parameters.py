"""ROS parameters of services: when to set them, and which services wait for that.

In ROS 1 they are set at the master before each start, as roslaunch does, and while the service runs if the master lacks
them: because the manifest changed or the master was restarted. A program of ROS 2 reads them from a file when it
starts; rorg sets those that have changed since.
"""

from __future__ import annotations

from dataclasses import replace

from rorg.core.digest import canonical
from rorg.core.memory import ProbeResult, Progress
from rorg.core.observed import Container
from rorg.core.situation import Situation
from rorg.model.catalog import Service
from rorg.model.probe import Probe

ROLE = "ros-parameters"
"""The role under which setting them is listed among a service's probes."""
AGAIN = 1.0
"""Seconds before a failed attempt is repeated,"""
LONGEST = 8.0
"""doubling up to this, until a run of the service or of one of its needs changes."""


def due(situation: Situation, service: Service) -> str:
    """Return an identifier of what the parameters must be set for: their values, and the runs of the service and its
    needs, including the master. "" if that is done or there are none."""
    if service.ros is None:
        return ""
    if service.domain is not None:
        return _due_at_nodes(situation, service)
    containers = situation.observed.by_service()
    firsts = [(containers.get(name) or (None,))[0] for name in (service.name, *sorted(service.needs))]
    runs = [(c.incarnation, c.alive) for c in firsts if c is not None and c.started_at]
    purpose = canonical([situation.desired.ros[service.name], runs])
    return "" if situation.memory.of(service.name).parameters == purpose else purpose


def _due_at_nodes(situation: Situation, service: Service) -> str:
    """Return the same for the nodes of a running program, if its parameters have changed since it began."""
    progress, current = situation.memory.of(service.name), situation.observed.current(service.name)
    run, digest = progress.begun_with
    now = situation.desired.ros[service.name]
    if current is None or not current.active or run != current.incarnation or digest == now:
        return ""
    purpose = canonical([now, run])
    return "" if progress.parameters == purpose else purpose


def begun_with(progress: Progress, service: Service, current: Container | None, digest: str) -> Progress:
    """Note which parameters a new run of a ROS 2 program has read: those that are declared when it begins."""
    if service.domain is None or current is None or not current.alive or progress.begun_with[0] == current.incarnation:
        return progress
    return replace(progress, begun_with=(current.incarnation, digest))


def probe_of(situation: Situation, service: Service) -> Probe:
    """Return the probe that compares them with the master's."""
    graph = service.ros.graph if service.ros else ""
    return Probe("ros_parameters", situation.desired.ros[service.name], interval=AGAIN, graph=graph)


def parameters_noted(progress: Progress, result: ProbeResult | None) -> Progress:
    """Note that they are set, or why the last attempt failed."""
    if result is None:
        return progress
    noted = (result.incarnation, "") if result.ok else (progress.parameters, result.message)
    if noted == (progress.parameters, progress.not_set):
        return progress
    return replace(progress, parameters=noted[0], not_set=noted[1])
