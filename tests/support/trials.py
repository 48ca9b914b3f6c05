"""Changes on trial, and the runs of their containers."""

from __future__ import annotations

from robots import RealRobot, VirtualRobot

OLD, NEW = {"EDITION": "old"}, {"EDITION": "new"}


def edition(environment: dict[str, str]) -> dict:
    container = {"environment": environment, "stop_grace_period": "2s"}
    return {"nav": {"always_on": True, "update": {"bake": "2m"}, "container": container}}


def on_trial(virtual: VirtualRobot) -> str:
    """The digest of a new edition, whose container has just begun."""
    virtual.declare(edition(OLD))
    virtual.settle()
    virtual.declare(edition(NEW))
    digest = virtual.sim.desired.digests["nav"]
    virtual.wait(lambda: runs(virtual) == digest)
    return digest


def runs(virtual: VirtualRobot) -> str:
    return next((c.digest for c in virtual.containers() if c.state == "running"), "")


def running(robot: RealRobot) -> str:
    """The digest of what the container that runs was made from."""
    return next((c.digest for c in robot.engine.list() if c.state == "running"), "")
