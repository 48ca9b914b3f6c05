"""Limits, logs and memory that do not fit expectations or the machine."""

from __future__ import annotations

import posixpath
from collections.abc import Iterator
from itertools import pairwise

from rorg.manifest.validation.robot import Finding, Robot, each, in_containers
from rorg.manifest.validation.subject import Subject
from rorg.model.graph import closure
from rorg.model.units import format_memory

OUTPUTS = ("-o", "-O", "--output", "--output-prefix", "--output-name")
ENDS = (
    *("--max-splits", "--duration", "--max-bag-size", "--max-bag-duration", "-d", "--limit", "-l"),
    *("--max-bag-files", "--max-record-size", "--max-record-duration", "--snapshot-mode"),
)
"""Options of recorders that end a file or the recording."""
OF_ROS2 = "--max-bag-size, and a job that deletes old files; --max-bag-files does so in new releases"
MOST_FILES = 1 << 20
"""Python 2 and roslaunch close every descriptor up to the limit for each process that they start."""


def memory_limit(subject: Subject) -> int:
    """Bytes; 0 for no limit."""
    return max(0, subject.options.get("mem_limit") or 0)


def always_on(robot: Robot) -> tuple[set[str], float, int]:
    """The services that are active without any request, with the cores and the bytes that they are expected to use."""
    services = robot.catalog.services
    names = closure(services, [s.name for s in services.values() if s.always_on])
    return names, sum(services[n].cpu for n in names), sum(services[n].memory for n in names)


def _expected(subject: Subject) -> Iterator[Finding]:
    """Limits below the expected use in the same manifest."""
    limit, cores = memory_limit(subject), subject.options.get("cpus") or 0
    memory, cpu = subject.service.memory, subject.service.cpu
    if 0 < limit < memory:
        message = f"mem_limit {format_memory(limit)} is below the {format_memory(memory)} of resources.memory: the "
        message += "kernel kills it"
        yield Finding("limit-below-expected", subject.option("mem_limit"), message)
    if 0 < cores < cpu:
        message = f"cpus {cores:g} is below the {cpu:g} of resources.cpu: it is always throttled"
        yield Finding("limit-below-expected", subject.option("cpus"), message)


def _budgets(robot: Robot) -> Iterator[Finding]:
    """Always-on services that exceed the Policy's budget, and services that it cannot count."""
    budget = robot.catalog.policy.budget
    policy = next(iter(robot.sources.get("Policy", {}).values()), None)
    if budget is None or policy is None:
        return
    _, cpu, memory = always_on(robot)
    for name, used, most, shown in (
        ("cpu", cpu, budget.cpu, f"{cpu:g} cores"),
        ("memory", memory, budget.memory, format_memory(memory)),
    ):
        if most is not None and used > most:
            message = f"always-on services use {shown}, more than the budget"
            yield Finding("always-on-over-budget", policy.where("spec", "budget", name), message)
    for subject in (s for s in robot.subjects if not (s.service.cpu or s.service.memory)):
        message = f"the Policy has a budget, but '{subject.name}' does not count in it"
        yield Finding("budget-without-resources", subject.source.where("metadata", "name"), message)


def _writing(subject: Subject) -> Iterator[Finding]:
    """Containers without a place for the logs that ROS writes before it does anything else: those that are read-only,
    and those of users that the image may not know, whose home is /."""
    writes = subject.options.get("tmpfs") or any(not m.read_only for m in subject.mounts)
    if subject.ros and subject.options.get("read_only") and not writes:
        message = f"'{subject.name}' cannot write anywhere, and ROS starts with a log file"
        yield Finding("read-only-ros", subject.option("read_only"), message)
    home = not {"HOME", "ROS_HOME", "ROS_LOG_DIR"}.isdisjoint(subject.env)
    home = home or any(mount.target == "/.ros" for mount in subject.mounts)
    if subject.ros and subject.uid.isdigit() and subject.uid != "0" and not home:
        message = f"user {subject.uid} has no home unless the image knows it, and ROS writes to ~/.ros"
        yield Finding("user-without-home", subject.option("user"), message)


def _logs(subject: Subject) -> Iterator[Finding]:
    logging = subject.options.get("logging") or {}
    if logging.get("driver", "json-file") != "json-file" or "max-size" in (logging.get("options") or {}):
        return
    if logging or subject.ros:
        where = subject.option("logging") if logging else subject.source.where("metadata", "name")
        message = f"the output of '{subject.name}' is kept in one file that grows until the disk is full"
        message += "" if logging else ", unless the engine's own configuration limits it"
        yield Finding("log-without-limits", where, message)


def _useless(subject: Subject) -> Iterator[Finding]:
    """Options that have no effect, or a bad one."""
    options = subject.options
    if options.get("tty") and not options.get("stdin_open"):
        message = f"'{subject.name}' has a terminal without input, and control characters in its output"
        yield Finding("tty-without-stdin", subject.option("tty"), message)
    if options.get("shm_size") and options.get("ipc") == "host":
        message = "under ipc: host the shared memory is that of this machine, and shm_size is ignored"
        yield Finding("shm-size-with-ipc-host", subject.option("shm_size"), message)
    if options.get("oom_kill_disable") and not memory_limit(subject):
        message = "the kernel may kill anything except this, which may take all memory"
        yield Finding("oom-kill-disabled-without-limit", subject.option("oom_kill_disable"), message)
    most = options.get("ulimits", {}).get("nofile", {}).get("soft", 0)
    if subject.ros1 and (most > MOST_FILES or most < 0):
        message = f"nofile {most}: roslaunch closes each of these for every node that it starts, which takes minutes"
        yield Finding("nofile-too-high", subject.option("ulimits", "nofile"), message)


def _zones(robot: Robot) -> Iterator[Finding]:
    """Services with different time zones, whose logs cannot be compared."""
    seen: dict[str, Subject] = {}
    for subject in (s for s in robot.subjects if s.env.get("TZ")):
        seen.setdefault(subject.env["TZ"], subject)
        first = next(iter(seen.values()))
        if subject.env["TZ"] != first.env["TZ"]:
            message = f"TZ is {subject.env['TZ']} here, and {first.env['TZ']} in '{first.name}'"
            yield Finding("time-zones-differ", subject.variable("TZ"), message)


def _bags(subject: Subject) -> Iterator[Finding]:
    for command in subject.commands:
        words = [w.rpartition("/")[2] for w in command]
        ros1 = "rosbag" in words and "record" in words
        ros2 = "ros2" in words and "bag" in words and "record" in words
        if (ros1 or ros2) and "timeout" not in words and not any(w.partition("=")[0] in ENDS for w in words):
            message = f"'{subject.name}' records until the disk is full"
            yield Finding("recording-without-limit", subject.command(), message, OF_ROS2 if ros2 else "")


def _lost_bags(subject: Subject) -> Iterator[Finding]:
    """Recordings in the container itself: they are gone with it."""
    kept = [mount.target for mount in subject.mounts if not mount.read_only]
    for command in subject.commands if not subject.options.get("volumes_from") else ():
        words = [w.rpartition("/")[2] for w in command]
        if "record" not in words or {"rosbag", "bag"}.isdisjoint(words):
            continue
        outputs = (b for a, b in pairwise(command) if a in OUTPUTS)
        path = next((w.partition("=")[2] for w in command if w.partition("=")[0] in OUTPUTS and "=" in w), "")
        path = posixpath.join(str(subject.options.get("working_dir") or ""), path or next(outputs, "."))
        if path.startswith("/") and "$" not in path:
            lost = not any(f"{posixpath.normpath(path)}/".startswith(f"{target}/") for target in kept)
        else:
            lost = not kept
        if lost:
            message = f"'{subject.name}' records into its container, and nothing is mounted there to keep it"
            yield Finding("recording-outside-mounts", subject.command(), message)


def _shared_memory(subject: Subject) -> Iterator[Finding]:
    size, limit = subject.options.get("shm_size") or 0, memory_limit(subject)
    if 0 < limit < size and subject.ipc != "host":
        message = f"shm_size {format_memory(size)} is part of mem_limit {format_memory(limit)}, and can never be full"
        yield Finding("shm-above-mem-limit", subject.option("shm_size"), message)


CHECKS = (
    _budgets,
    _zones,
    *map(each, (_expected, _writing, _logs, _useless, _bags, _shared_memory)),
    in_containers(each(_lost_bags)),
)
