"""Idle services: what pausing or stopping them does to the services that talk to them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import lru_cache

from rorg.manifest.validation.robot import Finding, Robot, each
from rorg.manifest.validation.subject import Subject
from rorg.manifest.validation.texts import LOCAL, calls_of, names_of_nodes, ports_of, texts_of

ACTUATORS = re.compile(
    r"cmd_vel|\b\w+_cmd\b|twist_mux|controller_manager|ros2?_control|trajectory_controller|follow_joint_trajectory|"
    r"ackermann|diff_drive|dynamixel|(?<![a-z])(motors?|wheels?|servos?|grippers?|thrusters?|actuators?)(?![a-z])",
    re.IGNORECASE,
)
"""Words that identify programs which move something."""
HINTS = (
    *("cmd", "twist_mux", "control", "trajectory", "ackermann", "diff_drive", "dynamixel"),
    *("motor", "wheel", "servo", "gripper", "thruster", "actuator"),
)
"""Parts of these words. Searching for them takes a hundredth of the time of the expression."""
LIMBS = re.compile(r"(?<![a-z])(arms?|base|chassis|drive|hands?|legs?|lift|manipulator|ptu)(?![a-z])")
"""Names of drivers that move something. Other services use these words too, so only drivers count."""
NEVER = 86_400.0
"""Seconds. A longer delay means: never ready while it runs."""
DISCOVERY = "a discovery server"
INFRASTRUCTURE = {
    "roscore": "the ROS master",
    "rosmaster": "the ROS master",
    "fast-discovery-server": DISCOVERY,
    "fastdds": DISCOVERY,
    "rmw_zenohd": "a router",
    "zenohd": "a router",
    "rosbridge_websocket": "a bridge",
    "rorg_ros": "rorg's own bridge",
    "mosquitto": "a message broker",
}
"""Programs that all others talk to, by the name of their command. A call to a paused one does not fail; it hangs until
the program resumes."""
DDS_LEASE = 20.0
"""Seconds after which Fast DDS gives up a node that is silent (measured: docs/how-to/ros2.md)."""
PREWARM = ("spec", "idle", "prewarm")
LATCHED = frozenset(("map_server", "static_transform_publisher", "robot_state_publisher", "tf2_ros"))


def _infrastructure(robot: Robot) -> Iterator[Finding]:
    for subject in (s for s in robot.subjects if s.service.idle.action == "pause"):
        names = (word.rpartition("/")[2] for word in subject.words)
        what = next((INFRASTRUCTURE[name] for name in names if name in INFRASTRUCTURE), "")
        if what:
            message = (
                f"'{subject.name}' would be paused when idle, but it is {what}: everything that talks to it would hang"
            )
            yield Finding("pause-of-infrastructure", subject.source.where("spec", "idle", "action"), message)


def _actuators(robot: Robot) -> Iterator[Finding]:
    for subject in (s for s in robot.subjects if s.pauses and not s.mindful):
        said = f"{subject.name} {subject.source.description}" if subject.service.driver else ""
        word = next(filter(None, map(_actuator, (*texts_of(subject), said))), "")
        limb = LIMBS.search(subject.name) if subject.service.driver and not word else None
        word = limb[0] if limb else word
        if word:
            message = f"'{subject.name}' is paused when idle, and it moves something ('{word}'): on resume it "
            message += "receives all commands sent meanwhile"
            yield Finding("pause-of-actuator-consumer", subject.at("idle", "action"), message)


@lru_cache(maxsize=2048)
def _actuator(text: str) -> str:
    """The first word that shows that it moves something; empty if there is none."""
    low = text.lower()
    match = ACTUATORS.search(text) if any(hint in low for hint in HINTS) else None
    return match[0] if match else ""


def _nodes(robot: Robot) -> Iterator[Finding]:
    """Services with the same node name in the ROS graph."""
    owners: dict[str, list[Subject]] = {}
    for subject in robot.ros1:
        for name in sorted(names_of_nodes(subject)):
            owners.setdefault(name, []).append(subject)
    told: set[tuple[str, str, str]] = set()
    for name, subjects in sorted((n, s) for n, s in owners.items() if len(s) > 1):
        for index, other in enumerate(subjects):
            for first in subjects[:index]:
                paused = next((s for s in (other, first) if s.pauses), None)
                if not robot.apart(first, other) and ("", first.name, other.name) not in told:
                    told.add(("", first.name, other.name))
                    message = f"'{first.name}' starts the ROS node '{name}' too, and nothing keeps them apart"
                    remedy = f"conflicts: [{first.name}]"
                    yield Finding("conflict-not-declared", other.command(), message, remedy)
                if paused and ("pause", first.name, other.name) not in told:
                    told.add(("pause", first.name, other.name))
                    rival = first if paused is other else other
                    message = f"'{paused.name}' is paused when idle, and '{rival.name}' takes its node name '{name}'"
                    yield Finding("duplicate-node-name", paused.at("idle", "action"), message)


def _callees(robot: Robot) -> Iterator[Finding]:
    """Paused services that others call, or that late subscribers must hear from."""
    for subject in (s for s in robot.subjects if s.pauses):
        where = subject.at("idle", "action")
        for asked in (a for a in subject.asked_ready if a.probe.kind == "ros_service"):
            message = f"calls of the ROS service {asked.probe.target} hang while '{subject.name}' is paused"
            yield Finding("pause-of-ros-service", where, message)
        latched = [] if subject.mindful else sorted(LATCHED & subject.programs)
        if latched:
            message = f"late subscribers get nothing from '{latched[0]}' while '{subject.name}' is paused"
            yield Finding("pause-of-latched-publisher", where, message)
        check = subject.options.get("healthcheck")
        if check and not check.get("disable") and check.get("test") != ["NONE"]:
            message = f"the engine's health check of '{subject.name}' fails while it is paused"
            yield Finding("pause-with-healthcheck", where, message)


def _leaving(robot: Robot) -> Iterator[Finding]:
    """Programs of ROS 2 whose pause may last until their peers give them up."""
    for subject in (s for s in robot.ros2 if s.pauses and not s.mindful):
        after, _ = subject.service.idle.escalate or (NEVER, "")
        if after > DDS_LEASE:
            message = f"'{subject.name}' runs ROS 2, and stays paused until something requests it"
            yield Finding("pause-of-ros2-node", subject.at("idle", "action"), message)


def _servers(robot: Robot) -> Iterator[Finding]:
    """Paused servers that others connect to without keeping them active."""
    for subject in (s for s in robot.subjects if s.pauses and not s.is_master and ports_of(s)):
        others = (s for s in robot.subjects if s is not subject and not robot.apart(s, subject))
        calls = [(s, port) for s in others if (port := _called(s, subject))]
        callers = {s.name: port for s, port in calls if subject.name not in robot.asks_for(s)}
        if callers:
            (first, port), *more = callers.items()
            so = f"; so do {', '.join(name for name, _ in more)}" if more else ""
            message = f"'{first}' calls '{subject.name}' at port {port}, and hangs while that is paused{so}"
            remedy = f"idle: {{action: stop}}, or needs: [{subject.name}] in {first}"
            yield Finding("pause-of-server", subject.at("idle", "action"), message, remedy)


def _called(caller: Subject, server: Subject) -> str:
    """The port of a server that a caller uses; empty if it uses none, or one on another host."""
    ports, names = ports_of(server), (server.name, server.service.container_name)
    shared = caller.network == "host" and (server.network == "host" or server.options.get("ports"))
    hosts = (*names, *(LOCAL if shared else ()))
    return next((port for host, port in sorted(calls_of(caller)) if port in ports and host in hosts), "")


def _lingering(subject: Subject) -> Iterator[Finding]:
    idle, ready = subject.service.idle, subject.service.ready
    if ready is None or ready.delay is None:
        return
    if ready.timeout <= ready.delay < NEVER:
        message = f"ready after {ready.delay:g} s, and late after {ready.timeout:g} s"
        yield Finding("ready-after-its-timeout", subject.at("ready", "delay"), message)
    if 0 < idle.linger < ready.delay and idle.action != "pause" and not subject.service.always_on:
        message = f"'{subject.name}' lingers {idle.linger:g} s, and needs {ready.delay:g} s to come up again"
        yield Finding("linger-shorter-than-start", subject.at("idle", "linger"), message)


def _never_paused(subject: Subject) -> Iterator[Finding]:
    """Services with `connected` that are never paused."""
    said = ("spec", "idle", "connected") in subject.source.document.values
    if said and subject.mindful and subject.service.idle.action != "pause":
        message = f"'{subject.name}' is not paused when idle, so `connected` has no effect"
        yield Finding("connected-without-pause", subject.at("idle", "connected"), message)


def _prewarmed(robot: Robot) -> Iterator[Finding]:
    """Services, profiles and Policies that still say `prewarm`."""
    for source in (source for by_name in robot.sources.values() for source in by_name.values()):
        if PREWARM in source.document.values:
            message = f"`prewarm` of the {source.kind} '{source.name}' has no effect"
            yield Finding("prewarm-without-effect", source.where(*PREWARM, key=True), message)


CHECKS = (
    *(_infrastructure, _actuators, _nodes, _callees, _leaving, _servers, _prewarmed),
    *map(each, (_never_paused, _lingering)),
)
