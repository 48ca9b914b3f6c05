"""ROS 1 parameters of services: when they are to be set at the master, and who waits for that.

Before each start of a service they are set, as roslaunch does it. While it runs, they are set where its master does not
have them: they are declared otherwise since, or the master was restarted.
"""

from __future__ import annotations

from dataclasses import replace

from rorg.core.digest import canonical
from rorg.core.memory import ProbeResult, Progress
from rorg.core.situation import Situation
from rorg.model.catalog import Probe, Service

ROLE = "ros-parameters"
"""Under which their being set is asked for, among the probes of a service."""
AGAIN = 1.0
"""Seconds after which a failed attempt is repeated at first."""
LONGEST = 8.0
"""Up to so many seconds this doubles, as long as attempts fail and no run of what the service needs is another one."""


def due(situation: Situation, service: Service) -> str:
    """What the parameters of a service are to be set for: their values, its own run, and those of what it needs, the
    master among them. Empty where that is done, or there are none."""
    if service.ros is None:
        return ""
    there = situation.observed.by_service()
    firsts = [(there.get(name) or (None,))[0] for name in (service.name, *sorted(service.needs))]
    runs = [(c.incarnation, c.alive) for c in firsts if c is not None and c.started_at]
    found = canonical([situation.desired.ros[service.name], runs])
    return "" if situation.memory.of(service.name).parameters == found else found


def probe_of(situation: Situation, service: Service) -> Probe:
    """What asks the master for them."""
    master = service.ros.master if service.ros else ""
    return Probe("ros_parameters", situation.desired.ros[service.name], interval=AGAIN, master=master)


def parameters_noted(step: Progress, found: ProbeResult | None) -> Progress:
    """That they are set, or why the last attempt failed."""
    if found is None:
        return step
    now = (found.incarnation, "") if found.ok else (step.parameters, found.message)
    if now == (step.parameters, step.not_set):
        return step
    return replace(step, parameters=now[0], not_set=now[1])
