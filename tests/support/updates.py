"""Steps of updates, and what runs during them."""

from __future__ import annotations

from dataclasses import replace

from rorg.model.units import stamp


def identity(robot, service: str) -> tuple[str, str]:
    """Which container it is, and since when it runs, as the engine says."""
    found = robot.container(service)
    return found.id, found.started_at


def failed(robot, service: str) -> str:
    """Why its update failed, as it is published."""
    conditions = robot.status().get("services", {}).get(service, {}).get("conditions", [])
    return next((c["message"] for c in conditions if c["type"] == "Updated" and c["status"] == "False"), "")


def running(robot, service: str):
    return next((c for c in robot.containers() if c.service == service and c.state == "running"), None)


def later(virtual, seconds: float) -> None:
    """So much virtual time goes by."""
    end = virtual.now() + seconds
    virtual.sim.at(end, lambda: None)
    virtual.wait(lambda: virtual.now() >= end, seconds + 1)


def retry(virtual, name: str) -> None:
    virtual.change(lambda asked: replace(asked, retries={name: stamp(virtual.wall())}))
