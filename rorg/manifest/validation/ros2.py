"""ROS 2: services find each other only in one domain, and shared memory carries data only between alike ones."""

from __future__ import annotations

from collections.abc import Iterator

from rorg.manifest.validation.finding import Finding
from rorg.manifest.validation.robot import Robot, minority
from rorg.manifest.validation.subject import Subject
from rorg.model.units import parse_memory

MOST_DOMAIN = 101
"""Above it, ports of a domain are those from which Linux takes ports for connections."""
SHARED = ("", "rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp")
"""Implementations that use shared memory by themselves."""
ALIKE = ("ROS_LOCALHOST_ONLY", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_DISCOVERY_SERVER", "ROS_STATIC_PEERS")
SMALLEST = 16 << 20


def _domains(robot: Robot) -> Iterator[Finding]:
    for subject in robot.ros2:
        text = subject.env.get("ROS_DOMAIN_ID", "0")
        if not (text.isdigit() and int(text) <= MOST_DOMAIN):
            message = f"ROS_DOMAIN_ID {text} is not from 0 to {MOST_DOMAIN}"
            yield Finding("ros2-domain-mismatch", subject.variable("ROS_DOMAIN_ID"), message, "0 to 101")
    for name, default in (("ROS_DOMAIN_ID", "0"), ("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")):
        values = {s.name: s.env.get(name, default) for s in robot.ros2}
        for subject, usual in minority(robot.ros2, values):
            said = values[subject.name] if name in subject.env else f"not set, which is {default},"
            message = f"{name} is {said} in '{subject.name}', and {usual} in others: they do not see each other"
            yield Finding("ros2-domain-mismatch", subject.variable(name), message, f"{usual} for all of them")


def _discovery(robot: Robot) -> Iterator[Finding]:
    for name in ALIKE:
        values = {s.name: s.env.get(name, "") for s in robot.ros2}
        for subject, usual in minority(robot.ros2, values):
            said = values[subject.name] or "not set"
            message = f"{name} is {said} in '{subject.name}', and {usual or 'not set'} in others"
            yield Finding("ros2-discovery-mismatch", subject.variable(name), message)


def shares_memory(subject: Subject) -> bool:
    """Whether its data goes through shared memory, where that can be had."""
    env = subject.env
    transports = env.get("FASTDDS_BUILTIN_TRANSPORTS", "")
    own = "FASTRTPS_DEFAULT_PROFILES_FILE" in env or "FASTDDS_DEFAULT_PROFILES_FILE" in env
    return env.get("RMW_IMPLEMENTATION", "") in SHARED and not own and "UDP" not in transports.upper()


def _memory(robot: Robot) -> Iterator[Finding]:
    for subject in (s for s in robot.ros2 if shares_memory(s)):
        if subject.network == "host" and subject.ipc in ("private", "none", "shareable"):
            message = (
                f"'{subject.name}' is on the host's network with shared memory of its own: topics are listed, and "
            )
            message += "no data arrives"
            yield Finding("ros2-host-net-private-ipc", subject.option("ipc"), message)
        size = subject.options.get("shm_size")
        if size is not None and subject.ipc != "host" and _bytes(size) < SMALLEST:
            message = f"shm_size {size} is too little for the shared memory of one participant"
            yield Finding("shm-too-small", subject.option("shm_size"), message)


def _bytes(value: object) -> int:
    try:
        return value if isinstance(value, int) else parse_memory(str(value))
    except ValueError:
        return SMALLEST


def _users(robot: Robot) -> Iterator[Finding]:
    together = [s for s in robot.ros2 if shares_memory(s) and s.ipc == "host"]
    for subject, usual in minority(together, {s.name: s.uid for s in together}):
        message = f"'{subject.name}' runs as user {subject.uid}, others as {usual}: they exchange no data"
        where = subject.option("user") if "user" in subject.options else subject.source.where("metadata", "name")
        yield Finding("ros2-mixed-uid", where, message, f'user: "{usual}" for all of them')


CHECKS = (_domains, _discovery, _memory, _users)
