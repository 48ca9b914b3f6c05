"""Hardware: stable names, least privileges, and no device for two services at a time."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator

from rorg.manifest.validation.robot import Finding, Robot, each, in_containers
from rorg.manifest.validation.subject import Subject
from rorg.model.diagnostics import HINT, Where

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
    (re.compile(r"/dev/snd"), "audio"),
)
DEVICE = re.compile(r"/dev/(?!shm|log|pts|mqueue|null$|zero$|random$|urandom$|full$|hugepages).+")
HARDWARE = re.compile(
    r"(?<![\w./-])/dev/(?!shm|std|fd\b|pts|ptmx|tty(?![A-Z])|console|null|zero|random|urandom|full|mqueue)[\w./-]*\w"
)
"""Devices in a command line, except those that each container has."""
MADE = re.compile(r"\b(socat|mknod|ln -s\w*|interceptty)\b")
"""Words of scripts that make devices, or give them other names."""
DRIVERS = {
    "joy_node": ("/dev/input/",),
    "game_controller_node": ("/dev/input/",),
    "usb_cam_node": ("/dev/video", "/dev/v4l/"),
    "usb_cam_node_exe": ("/dev/video", "/dev/v4l/"),
    "v4l2_camera_node": ("/dev/video", "/dev/v4l/"),
    "realsense2_camera_node": ("/dev/bus/usb/", "/dev/video"),
}
"""Nodes that do nothing without one of these devices."""
_DEBIAN = """
root daemon bin sys adm tty disk lp mail news uucp man proxy kmem dialout fax voice cdrom floppy tape sudo audio dip
www-data backup operator list irc src shadow utmp video sasl plugdev staff games users nogroup"""
DEBIAN = tuple(_DEBIAN.split())
"""The groups of every image of Debian and Ubuntu."""
HARDWARE_GROUPS = ("audio", "dialout", "input", "plugdev", "render", "video")
ADDED = ("bluetooth", "docker", "gpio", "i2c", "input", "kvm", "netdev", "pulse-access", "render", "spi")
"""Groups that packages add on a machine, and seldom in images."""
CAN = re.compile(r"(?<![\w./-])(?:v|sl)?can[0-9]{1,2}(?![\w./:-])")


def _paths(subject: Subject) -> Iterator[Finding]:
    named = [(host, subject.device(host)) for host, _ in subject.devices]
    named += [(m.path, subject.volume(m)) for m in subject.mounts if m.path.startswith("/dev/")]
    by_remedy = dict[str, dict[str, Where]]()
    for host, where in named:
        stable = next((remedy for form, remedy in UNSTABLE if form.fullmatch(host)), "")
        if stable:
            by_remedy.setdefault(stable, {}).setdefault(host, where)
    for stable, places in by_remedy.items():
        are = "another device" if len(places) == 1 else "other devices"
        message = f"{', '.join(places)} may be {are} after unplugging, or after a reboot of the machine"
        yield Finding("unstable-device-path", min(places.values()), message, stable)


def _whole(subject: Subject) -> Iterator[Finding]:
    driver = subject.source.spec.driver
    for mount in subject.mounts if driver is None or not driver.hotplug else ():
        if mount.path == "/dev":
            message = f"'{subject.name}' mounts /dev whole, with the shared memory of this machine"
            told = HINT if subject.options.get("privileged") else ""  # the finding `privileged` covers it
            yield Finding("whole-dev-mounted", subject.volume(mount), message, severity=told)
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
        message = f"'{subject.name}' has rtprio, and not SYS_NICE: its nice value cannot become negative"
        yield Finding("realtime-without-sys-nice", where, message)
    elif "SYS_NICE" in caps and "rtprio" not in limits and subject.uid != "0":
        message = f"user {subject.uid} cannot use SYS_NICE: only root keeps capabilities"
        yield Finding("sys-nice-without-rtprio", subject.item("cap_add", "SYS_NICE", "CAP_SYS_NICE"), message)


def _named(subject: Subject) -> Iterator[Finding]:
    """Devices that the command names, and that are not in the container, or only under another path."""
    if subject.options.get("privileged") or MADE.search(subject.script):
        return
    inside = [*(target for _, target in subject.devices), *(m.target for m in subject.mounts)]
    hosts = dict(subject.devices)
    for path in dict.fromkeys(path for word in subject.words if "/dev/" in word for path in HARDWARE.findall(word)):
        if not any(f"{path}/".startswith(f"{target.rstrip('/')}/") for target in inside):
            other = hosts.get(path, "")
            message = f"the command names {path}, which is {other} in the container" if other else ""
            message = message or f"the command names {path}, which '{subject.name}' is not given"
            remedy = f"{other} in the command" if other else f"driver: {{devices: [{path}]}}"
            yield Finding("device-not-given", subject.command(), message, remedy)


def _drivers(subject: Subject) -> Iterator[Finding]:
    """Drivers without any device of their kind."""
    given = [*(target for _, target in subject.devices), *(m.target for m in subject.mounts)]
    for name in sorted(subject.executables & DRIVERS.keys()) if not subject.options.get("privileged") else ():
        paths = DRIVERS[name]
        if not any(path.startswith(paths) or any(p.startswith(f"{path}/") for p in paths) for path in given):
            message = f"{name} reads {' or '.join(paths)}, and '{subject.name}' is given no such device"
            yield Finding("program-without-device", subject.command(), message)


def _members(subject: Subject) -> Iterator[Finding]:
    """Groups that the image does not know: the engine then refuses to start the container."""
    for name in map(str, subject.options.get("group_add") or ()):
        if name.isdigit() or name in DEBIAN:
            continue
        close = "" if name in ADDED else next(iter(difflib.get_close_matches(name, HARDWARE_GROUPS, 1, 0.8)), "")
        if close:
            message = f"there is hardly a group '{name}' in the image"
            yield Finding("misspelt-group", subject.group(name), message, close)
        elif name in ADDED:
            message = f"images of Debian and Ubuntu have no group '{name}', unless a package adds it"
            yield Finding("group-not-in-image", subject.group(name), message)


def _can(robot: Robot) -> Iterator[Finding]:
    """Interfaces of a CAN bus, which only the host's network has."""
    for subject in robot.subjects:
        match = next((m for word in subject.words if (m := CAN.search(word))), None)
        if match and robot.whose(subject, "network_mode") != "host" and "ip link add" not in subject.script:
            message = f"'{subject.name}' uses {match[0]}, which its network ({subject.network}) does not have"
            yield Finding("can-without-host-network", subject.command(), message)


CHECKS = (
    _shared,
    *map(each, (_paths, _whole, _bound, _privileges, _groups)),
    *map(in_containers, (_can, *map(each, (_named, _drivers, _members, _realtime)))),
)
