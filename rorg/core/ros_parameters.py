"""ROS 1 parameters of services: when to set them at the master, and which services wait for that.

They are set before each start, as roslaunch does, and while the service runs if the master lacks them: because the
manifest changed or the master was restarted.
"""

from __future__ import annotations

from dataclasses import replace

from rorg.core.digest import canonical
from rorg.core.memory import ProbeResult, Progress
from rorg.core.situation import Situation
from rorg.model.catalog import Probe, Service

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
    containers = situation.observed.by_service()
    firsts = [(containers.get(name) or (None,))[0] for name in (service.name, *sorted(service.needs))]
    runs = [(c.incarnation, c.alive) for c in firsts if c is not None and c.started_at]
    purpose = canonical([situation.desired.ros[service.name], runs])
    return "" if situation.memory.of(service.name).parameters == purpose else purpose


def probe_of(situation: Situation, service: Service) -> Probe:
    """Return the probe that compares them with the master's."""
    master = service.ros.master if service.ros else ""
    return Probe("ros_parameters", situation.desired.ros[service.name], interval=AGAIN, master=master)


def parameters_noted(progress: Progress, result: ProbeResult | None) -> Progress:
    """Note that they are set, or why the last attempt failed."""
    if result is None:
        return progress
    noted = (result.incarnation, "") if result.ok else (progress.parameters, result.message)
    if noted == (progress.parameters, progress.not_set):
        return progress
    return replace(progress, parameters=noted[0], not_set=noted[1])
