"""Probes as pydantic models: `ready`, `live` and `interlock`."""

from __future__ import annotations

from typing import Annotated, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, BeforeValidator, Field, WithJsonSchema, model_validator

from rorg.manifest.fields import Written, unchanging
from rorg.manifest.option_forms import Duration, Interval, Strict, Words
from rorg.manifest.patterns import compiled


def _port(value: object) -> str:
    port = str(value).rpartition(":")[2]
    if isinstance(value, bool) or not port.isdigit() or not 0 < int(port) < 65536:
        raise ValueError("must be PORT or HOST:PORT, with a port from 1 to 65535")
    return str(value)


def _url(value: str) -> str:
    if not value.startswith("http://"):
        raise ValueError("must be a URL that begins with http://")
    try:
        parts = urlsplit(value)
        fine = bool(parts.hostname) and parts.port != 0 and value.isascii() and value.isprintable() and " " not in value
    except ValueError:
        fine = False
    if not fine:
        raise ValueError("must be a URL such as http://localhost:8080/health")
    return value


def _absolute(value: str) -> str:
    if not value.startswith("/"):
        raise ValueError("must begin with /")
    return value


def _pattern(value: str) -> str:
    compiled(value)
    return value


Port = Annotated[
    str, BeforeValidator(_port), WithJsonSchema({"type": ["integer", "string"]}), Written("PORT | HOST:PORT")
]
Url = Annotated[str, AfterValidator(_url), Written("URL")]
Absolute = Annotated[str, AfterValidator(_absolute), Written("text that begins with /")]
Pattern = Annotated[str, AfterValidator(_pattern), Written("regular expression")]
Failures = Annotated[int, Field(ge=1, le=1000)]


class Probe(Strict):
    """Exactly one of the forms, and its interval."""

    tcp: Port | None = unchanging("PORT, or HOST:PORT, accepts a connection.", 9090)
    http: Url | None = unchanging(
        "A GET of this http:// URL answers 2xx or 3xx. No redirect is followed.", "http://localhost:8080/health"
    )
    file: Absolute | None = unchanging("This file was written since the service started.", "/tmp/camera-ready")
    interval: Interval | None = unchanging(
        "Time between two probes, at least 50ms.", "2s", unset="250ms, exec 1s; live 10s"
    )

    @model_validator(mode="after")
    def _one(self) -> Probe:
        forms = [n for n in FORMS if n in type(self).model_fields]
        if sum(getattr(self, name) is not None for name in forms) != 1:
            raise ValueError(f"exactly one of {', '.join(forms)} must be given")
        return self


class TopicRate(Strict):
    """A topic, and how many messages a second it must have."""

    topic: Absolute = unchanging("The topic.", "/scan", ...)
    hz: Annotated[float, Field(strict=False, gt=0, le=10_000), Written("number")] = unchanging(
        "Messages a second, at least.", 8, ...
    )


class Lifecycle(Strict):
    """A managed node of ROS 2, and the state that it must be in."""

    node: Absolute = unchanging("The node.", "/amcl", ...)
    state: Literal["unconfigured", "inactive", "active", "finalized"] = unchanging("The state.", "inactive", "active")


class ServiceProbe(Probe):
    """Exactly one of the forms, including those that look into a service's container or at the ROS graph."""

    exec: Words | None = unchanging(
        "This command, run inside the container, exits 0. Costs about 50 ms each time; the others cost 1 or 2.",
        "rosnode ping -c 1 /move_base",
    )
    log: Pattern | None = unchanging("A line of the output matches this regular expression.", "odom received")
    engine: Literal["healthy"] | None = unchanging("The engine's own health check says healthy.", "healthy")
    ros_node: Absolute | None = unchanging("This ROS node is in the graph and answers.", "/move_base")
    ros_topic: Absolute | None = unchanging("This ROS topic has a publisher.", "/scan")
    ros_rate: TopicRate | None = unchanging(
        "This topic has that many messages a second. ROS 2 only.", {"topic": "/scan", "hz": 8}
    )
    ros_service: Absolute | None = unchanging("This ROS service exists and its node answers.", "/move_base/make_plan")
    ros_action: Absolute | None = unchanging("This ROS action has a server.", "/navigate_to_pose")
    ros_parameter: Absolute | None = unchanging(
        "This ROS parameter is set. In ROS 2, the last part of the name is the parameter, the rest is the node.",
        "/amcl/use_sim_time",
    )
    lifecycle: Lifecycle | None = unchanging(
        "This managed node is in that state. ROS 2 only.", {"node": "/amcl", "state": "active"}
    )


class Probes(ServiceProbe):
    """One form, or several that must hold together."""

    all: Annotated[list[ServiceProbe], Field(min_length=1, max_length=32)] | None = unchanging(
        "All of these hold. Each may have an `interval` of its own.", [{"ros_node": "/move_base"}, {"tcp": 9090}]
    )


class Ready(Probes):
    """When a running service counts as ready. Without it, running is ready."""

    delay: Duration | None = unchanging("Ready after this time since its start.", "3s")
    completed: Literal[True] | None = unchanging(
        "It is a task: what needs it waits until it has ended with exit code 0. Needs `restart: never` or on-failure.",
        True,
    )
    timeout: Duration = unchanging("Longest time to become ready; after it the service counts as late.", "60s", 30.0)
    failures: Failures | None = unchanging(
        "Keeps probing a ready service, at most once a second. After so many failures in a row it is no longer ready.",
        3,
        unset="it stays ready until it is resumed or restarted",
    )


class Live(Probes):
    """Restarts a service that runs, was ready, and no longer answers. `file`: it must be touched at least every
    `interval`."""

    failures: Failures = unchanging("Failures in a row before the restart.", 5, 3)


class Interlock(Probe):
    """A check that must allow it before rorg touches a container of this service. `file`: it exists on this machine."""


FORMS = (
    *("delay", "completed", "tcp", "http", "file", "exec", "log", "engine"),
    *("ros_node", "ros_topic", "ros_rate", "ros_service", "ros_action", "ros_parameter", "lifecycle", "all"),
)
