"""Checks of a robot against the machine that it will run on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from rorg.manifest.documents import Source
from rorg.manifest.validation.codes import CODES
from rorg.manifest.validation.limits import always_on, memory_limit
from rorg.manifest.validation.robot import Finding, Robot
from rorg.manifest.validation.ros2 import shares_memory
from rorg.manifest.validation.run import allowed, allows_of, diagnostics
from rorg.manifest.validation.subject import Subject
from rorg.model.catalog import Catalog
from rorg.model.diagnostics import Diagnostic
from rorg.model.machine import ABSENT, DEVICE, DIRECTORY, Machine
from rorg.model.run_directory import RUN
from rorg.model.units import format_memory
from rorg.model.volumes import Mount

OF_CGROUP_1 = ("mem_swappiness", "oom_kill_disable", "cpu_rt_runtime", "cpu_rt_period")
ENOUGH_SHM = 64 << 20
"""Bytes. A participant of Fast DDS takes 0.6 MB; images and point clouds take several times their size."""
WRITES, OTHERS_WRITE = 0o222, 0o002


def named_paths(catalog: Catalog, sources: Mapping[str, Mapping[str, Source]]) -> set[str]:
    """The paths of the machine that a robot uses: devices and mounts."""
    robot = Robot(catalog, sources)
    devices = {host for s in robot.subjects for host, _ in s.devices if host.startswith("/")}
    return devices | {m.path for s in robot.subjects for m in s.mounts if m.path and not m.source.startswith(RUN)}


def check_machine(catalog: Catalog, sources: Mapping[str, Mapping[str, Source]], machine: Machine) -> list[Diagnostic]:
    """Returns what cannot work on this machine, without what comments allow."""
    robot = Robot(catalog, sources)
    allows = [a for a in allows_of(sources) if a.code in CODES and CODES[a.code].machine and a.reason]
    findings = (f for s in robot.subjects for check in _CHECKS for f in check(s, machine))
    return allowed(
        diagnostics([*findings, *_sum(robot, machine), *_shared_memory(robot, machine)]), allows, machine=True
    )


def _devices(subject: Subject, machine: Machine) -> Iterator[Finding]:
    for device in subject.service.devices:
        if device.udev and device in machine.plugged and (problem := machine.plugged[device].problem):
            yield Finding("missing-device", subject.device(device.identity), f"{device} {problem}")
    for host, _ in subject.devices:
        node = machine.nodes.get(host)
        if node is None or node.kind == DIRECTORY:
            continue
        if node.kind != DEVICE:
            what = "is missing" if node.kind == ABSENT else f"is a {node.kind}, not a device"
            yield Finding("missing-device", subject.device(host), f"{host} {what}", node.near)
            continue
        groups = {str(g) for g in subject.options.get("group_add") or ()}
        user = str(subject.options.get("user") or "")
        mine = groups | ({user.partition(":")[2]} if ":" in user else set())
        shut = subject.uid.isdigit() and int(subject.uid) not in (0, node.uid) and not node.mode & OTHERS_WRITE
        if shut and not {str(node.gid), node.group} & mine and not subject.options.get("privileged"):
            message = f"{host} belongs to the group {node.group or node.gid} ({node.gid}) here, and user "
            message += f"{subject.uid} is not in it"
            remedy = f'driver: {{groups: ["{node.gid}"]}}'
            yield Finding("device-of-other-group", subject.device(host), message, remedy)


def _mounts(subject: Subject, machine: Machine) -> Iterator[Finding]:
    for mount in subject.mounts:
        node = machine.nodes.get(mount.path)
        if node is None or mount in subject.mounts_of_tree:
            continue
        if node.kind == ABSENT:
            message = f"{mount.path} is missing, and the engine creates an empty directory there"
            yield Finding("missing-host-path", subject.volume(mount), message, node.near)
    yield from (f for m in subject.mounts for f in _writes(subject, m, machine))


def _writes(subject: Subject, mount: Mount, machine: Machine) -> Iterator[Finding]:
    """A directory that the container's user cannot write to, though it is not mounted read-only."""
    node = machine.nodes.get(mount.path)
    if node is None or node.kind != DIRECTORY or mount.read_only or not subject.uid.isdigit() or subject.uid == "0":
        return
    groups = {str(g) for g in subject.options.get("group_add") or ()}
    groups.add(str(subject.options.get("user")).partition(":")[2] or subject.uid)
    owner = int(subject.uid) == node.uid and bool(node.mode & 0o200)
    group = bool({str(node.gid), node.group} & groups) and bool(node.mode & 0o020)
    if not (owner or group or node.mode & OTHERS_WRITE):
        message = f"user {subject.uid} may not write to {mount.path}, which belongs to {node.uid}:{node.gid}"
        remedy = f"chown {subject.uid} {mount.path}, or :ro"
        yield Finding("mount-not-writable", subject.volume(mount), message, remedy)


def _ports(subject: Subject, machine: Machine) -> Iterator[Finding]:
    for index, port in subject.published:
        if port.port.endswith("/tcp") and int(port.host) in machine.ports:
            program = machine.ports[int(port.host)]
            message = f"port {port.host} of this machine is in use" + (f" by {program}" if program else "")
            yield Finding("port-in-use", subject.item("ports", subject.options["ports"][index]), message)


def _runtimes(subject: Subject, machine: Machine) -> Iterator[Finding]:
    if machine.runtimes is None:
        return
    runtime = str(subject.options.get("runtime") or "")
    if runtime and runtime not in machine.runtimes:
        code = "gpu-without-runtime" if runtime == "nvidia" else "missing-runtime"
        yield Finding(code, subject.option("runtime"), f"the engine has no runtime '{runtime}'")
    elif subject.options.get("gpus") and "nvidia" not in machine.runtimes:
        message = f"'{subject.name}' wants a GPU, and the engine names no nvidia runtime: it may refuse"
        yield Finding("gpu-without-runtime", subject.option("gpus"), message)


def _engine(subject: Subject, machine: Machine) -> Iterator[Finding]:
    """Options that the manifest itself sets: what a profile sets for everyone is no wish of this service."""
    for name in sorted(subject.options.keys() - set(subject.service.defaults)):
        if name in machine.lacking:
            yield Finding("engine-lacks", subject.option(name), f"{name}: {machine.lacking[name]}")
    if not machine.pauses and subject.service.idle.action == "pause":
        yield Finding("engine-lacks", subject.at("idle", "action"), "the engine cannot pause: rorg stops instead")


def _kernel(subject: Subject, machine: Machine) -> Iterator[Finding]:
    options, limits = subject.options, subject.options.get("ulimits") or {}
    for name in OF_CGROUP_1:
        if options.get(name) and machine.cgroup == 2:
            yield Finding("cgroup-version", subject.option(name), f"{name} is of cgroup v1, and this machine has v2")
    for name, limit in (("nofile", "fs.nr_open"), ("nproc", "kernel.pid_max")):
        most = max(limits.get(name, {}).values(), default=0)
        if limit in machine.sysctls and most > machine.sysctls[limit]:
            message = f"{name} {most} is above {limit}, which is {machine.sysctls[limit]} here"
            yield Finding("limit-above-kernel", subject.option("ulimits", name), message)
    if "rtprio" in limits and machine.sysctls.get("kernel.sched_rt_runtime_us", -1) == 0:
        message = "kernel.sched_rt_runtime_us is 0 here: nothing may run at a real-time priority"
        yield Finding("realtime-throttled", subject.option("ulimits", "rtprio"), message)


def _size(subject: Subject, machine: Machine) -> Iterator[Finding]:
    cores, memory = subject.options.get("cpus") or 0, memory_limit(subject)
    if cores > machine.cpus:
        message = f"cpus {cores:g}, and this machine has {machine.cpus}: the engine refuses it"
        yield Finding("more-than-machine", subject.option("cpus"), message)
    if machine.memory and memory > machine.memory:
        message = f"mem_limit {format_memory(memory)}, and this machine has {format_memory(machine.memory)}"
        yield Finding("more-than-machine", subject.option("mem_limit"), message)


def _sum(robot: Robot, machine: Machine) -> Iterator[Finding]:
    """Always-on services that need more than the machine has."""
    by_name, (always, cpu, memory) = robot.by_name, always_on(robot)
    for used, most, shown in ((cpu, machine.cpus, f"{cpu:g} cores"), (memory, machine.memory, format_memory(memory))):
        if most and used > most and by_name:
            worst = max((by_name[n] for n in always if n in by_name), key=lambda s: (s.service.memory, s.name))
            message = f"always-on services use {shown}, more than this machine has"
            yield Finding("more-than-machine", worst.at("resources"), message, "fewer services that are always on")


def _shared_memory(robot: Robot, machine: Machine) -> Iterator[Finding]:
    """The shared memory that ROS 2 needs; reported once, because all services share it."""
    users = [s for s in robot.ros2 if shares_memory(s) and s.ipc == "host"]
    if users and machine.shm is not None and machine.shm < ENOUGH_SHM:
        message = f"{format_memory(machine.shm)} of /dev/shm are free here, and {users[0].name} sends through it"
        yield Finding("shm-nearly-full", users[0].option("ipc"), message)


_CHECKS = (_devices, _mounts, _ports, _runtimes, _engine, _kernel, _size)
