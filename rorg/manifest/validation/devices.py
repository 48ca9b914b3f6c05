"""Hardware: stable names, least privileges, and no device for two services at a time."""

from __future__ import annotations

import re
from collections.abc import Iterator

from rorg.manifest.validation.robot import Finding, Robot, each
from rorg.manifest.validation.subject import Subject

UNSTABLE = (
    (re.compile(r"/dev/tty(USB|ACM)[0-9]+"), "/dev/serial/by-id/..."),
    (re.compile(r"/dev/video[0-9]+"), "/dev/v4l/by-id/..."),
    (re.compile(r"/dev/input/(event|js|mouse)[0-9]+"), "/dev/input/by-id/..."),
    (re.compile(r"/dev/hidraw[0-9]+|/dev/bus/usb/.+"), "a link by a udev rule of your own"),
    (re.compile(r"/dev/sd[a-z]+[0-9]*"), "/dev/disk/by-id/..."),
)
"""Names that the kernel counts up, and stable alternatives."""
ALONE = re.compile(r"/dev/(tty(USB|ACM|S|AMA|THS)\w*|serial/.+|video[0-9]+|v4l/.+|input/(?!mice).+|hidraw[0-9]+)")
"""Devices that two programs cannot share: each gets half of the data, or an error."""
GROUPS = (
    (re.compile(r"/dev/(tty|serial/)"), "dialout"),
    (re.compile(r"/dev/(video|v4l/)"), "video"),
    (re.compile(r"/dev/input/"), "input"),
)
DEVICE = re.compile(r"/dev/(?!shm|log|pts|mqueue|null$|zero$|random$|urandom$|full$|hugepages).+")
NVIDIA = ("NVIDIA_VISIBLE_DEVICES", "NVIDIA_DRIVER_CAPABILITIES")


def _paths(subject: Subject) -> Iterator[Finding]:
    named = [(host, subject.device(host)) for host, _ in subject.devices]
    named += [(m.path, subject.volume(m)) for m in subject.mounts if m.path.startswith("/dev/")]
    for host, where in named:
        stable = next((remedy for form, remedy in UNSTABLE if form.fullmatch(host)), "")
        if stable:
            message = f"{host} may be another device after unplugging, or after a reboot of the machine"
            yield Finding("unstable-device-path", where, message, stable)


def _whole(subject: Subject) -> Iterator[Finding]:
    driver = subject.source.spec.driver
    for mount in subject.mounts if driver is None or not driver.hotplug else ():
        if mount.path == "/dev":
            message = f"'{subject.name}' mounts /dev whole, with the shared memory of this machine"
            yield Finding("whole-dev-mounted", subject.volume(mount), message)
    if host := next((host for host, _ in subject.devices if host.rstrip("/") == "/dev"), ""):
        message = f"'{subject.name}' gets every device that exists when its container is created"
        yield Finding("whole-dev-mounted", subject.device(host), message)


def _bound(subject: Subject) -> Iterator[Finding]:
    """A device file without the right to use it: the kernel checks the control group, not only the file."""
    if subject.options.get("privileged") or subject.options.get("device_cgroup_rules"):
        return
    given = {host for host, _ in subject.devices}
    for mount in subject.mounts:
        if DEVICE.match(mount.path) and not any(mount.path == g or g.startswith(f"{mount.path}/") for g in given):
            message = f"{mount.path} is mounted as a file, and opening it is not permitted"
            remedy = f"driver: {{devices: [{mount.path}]}}"
            yield Finding("device-as-volume", subject.volume(mount), message, remedy)


def _privileges(subject: Subject) -> Iterator[Finding]:
    if subject.options.get("privileged"):
        more = ", so the devices of its driver have no effect" if subject.service.driver else ""
        message = f"'{subject.name}' has all devices and all capabilities: it is root on this machine{more}"
        yield Finding("privileged", subject.option("privileged"), message)
    for cap in subject.options.get("cap_add") or ():
        short = str(cap).upper().removeprefix("CAP_")
        if short in ("SYS_ADMIN", "ALL"):
            yield Finding("sys-admin", subject.item("cap_add", cap), f"{cap} is as much as root on this machine")


def _shared(robot: Robot) -> Iterator[Finding]:
    first: dict[str, Subject] = {}
    for subject in robot.subjects:
        for host, _ in subject.devices:
            other = first.setdefault(host, subject)
            if other is not subject and ALONE.fullmatch(host) and not robot.apart(other, subject):
                message = f"{host} is used by '{other.name}' too, and both may run at the same time"
                remedy = f"conflicts: [{other.name}], or exclusive: [{re.sub('[^a-z0-9]+', '-', subject.name)}] in both"
                yield Finding("device-shared", subject.device(host), message, remedy)


def _groups(subject: Subject) -> Iterator[Finding]:
    if subject.uid == "0" or subject.options.get("group_add") or subject.options.get("privileged"):
        return
    for host, _ in subject.devices:
        group = next((name for form, name in GROUPS if form.match(host)), "")
        if group and ":" not in str(subject.options.get("user", "")):
            message = f"user {subject.uid} is not in the group that {host} belongs to"
            yield Finding("device-without-group", subject.device(host), message, f"driver: {{groups: [{group}]}}")


def _realtime(subject: Subject) -> Iterator[Finding]:
    limits = subject.options.get("ulimits") or {}
    caps = {str(c).upper().removeprefix("CAP_") for c in subject.options.get("cap_add") or ()}
    nice = bool({"SYS_NICE", "ALL"} & caps) or bool(subject.options.get("privileged"))
    if "rtprio" in limits and not nice:
        where = subject.option("ulimits", "rtprio")
        yield Finding("realtime-without-sys-nice", where, f"'{subject.name}' has rtprio, and not SYS_NICE")
    elif "SYS_NICE" in caps and "rtprio" not in limits and subject.uid != "0":
        message = f"user {subject.uid} cannot use SYS_NICE: only root keeps capabilities"
        yield Finding("sys-nice-without-rtprio", subject.item("cap_add", "SYS_NICE", "CAP_SYS_NICE"), message)


def _screens(subject: Subject) -> Iterator[Finding]:
    display = subject.env.get("DISPLAY", "")
    if display.startswith(":") and not any(
        m.target.startswith("/tmp") and "X11" in m.target + m.source for m in subject.mounts
    ):
        message = f"DISPLAY is {display}, and its socket is not in the container"
        yield Finding("display-without-x11", subject.variable("DISPLAY"), message)
    elif display.startswith(":") and subject.ipc != "host" and subject.env.get("QT_X11_NO_MITSHM") != "1":
        message = f"'{subject.name}' offers the screen shared memory, and ipc: {subject.ipc} hides it from the server"
        yield Finding("x11-private-ipc", subject.variable("DISPLAY"), message)
    name = next((n for n in NVIDIA if subject.env.get(n) not in (None, "", "none", "void")), "")
    if name and not subject.options.get("gpus") and subject.options.get("runtime") != "nvidia":
        message = f"{name} is set, and '{subject.name}' is given no GPU, unless the engine's default runtime "
        message += "gives it one"
        yield Finding("gpu-variables-without-gpu", subject.variable(name), message)


CHECKS = (_shared, *map(each, (_paths, _whole, _bound, _privileges, _groups, _realtime, _screens)))
