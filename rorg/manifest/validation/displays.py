"""Screens, GPUs, and the files and sockets that variables name: whether a container has them."""

from __future__ import annotations

import re
from collections.abc import Iterator

from rorg.manifest.validation.robot import Finding, each, in_containers
from rorg.manifest.validation.subject import Subject

NVIDIA = ("NVIDIA_VISIBLE_DEVICES", "NVIDIA_DRIVER_CAPABILITIES")
WINDOWS = frozenset(
    (
        *("rviz", "rviz2", "rqt", "rqt_graph", "rqt_plot", "rqt_image_view", "rqt_console", "rqt_tf_tree"),
        *("plotjuggler", "gzclient", "turtlesim_node", "image_view"),
    )
)
"""Programs that only draw windows."""
DRAWING = frozenset(("rviz", "rviz2", "gazebo", "gzserver", "gzclient", "gz", "ign"))
"""Programs that draw with OpenGL."""
ELSEWHERE = re.compile(r"xvfb|vnc|DISPLAY=", re.IGNORECASE)
"""Words of scripts that make or choose a screen of their own."""
FILES = (
    *("CYCLONEDDS_URI", "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "ROSCONSOLE_CONFIG_FILE"),
    *("ZENOH_SESSION_CONFIG_URI", "ZENOH_ROUTER_CONFIG_URI", "XAUTHORITY", "PULSE_SERVER", "PULSE_COOKIE"),
    *("DBUS_SESSION_BUS_ADDRESS", "SSH_AUTH_SOCK"),
)
"""Variables that name a file or a socket."""
NAMED = re.compile(r"(?:file://|unix:(?:path=)?)?(/[^,;]+)")


def _screens(subject: Subject) -> Iterator[Finding]:
    display = subject.env.get("DISPLAY", "")
    if display.startswith(":") and not any(
        m.target.startswith("/tmp") and "X11" in m.target + m.source for m in subject.mounts
    ):
        unless = ", unless the X server has an abstract socket, too" if subject.network == "host" else ""
        message = f"DISPLAY is {display}, and its socket is not in the container{unless}"
        yield Finding("display-without-x11", subject.variable("DISPLAY"), message)
    elif display.startswith(":") and subject.ipc != "host" and subject.env.get("QT_X11_NO_MITSHM") != "1":
        message = f"'{subject.name}' offers the screen shared memory, and ipc: {subject.ipc} hides it from the server"
        yield Finding("x11-private-ipc", subject.variable("DISPLAY"), message)


def _windows(subject: Subject) -> Iterator[Finding]:
    """Programs that draw windows, in containers that know no screen."""
    programs = WINDOWS & subject.executables
    if not programs or not {"DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM"}.isdisjoint(subject.env):
        return
    if not ELSEWHERE.search(" ".join(subject.words)):
        message = f"{min(programs)} opens a window, and DISPLAY is not set, unless the image sets it"
        yield Finding("window-without-display", subject.command(), message)


def _gpus(subject: Subject) -> Iterator[Finding]:
    given = subject.options.get("gpus") or subject.options.get("runtime") == "nvidia"
    name = next((n for n in NVIDIA if subject.env.get(n) not in (None, "", "none", "void")), "")
    if name and not given:
        message = f"{name} is set, and '{subject.name}' is given no GPU, unless the engine's default runtime "
        message += "gives it one"
        yield Finding("gpu-variables-without-gpu", subject.variable(name), message)
    said, draws = subject.env.get(NVIDIA[1]), DRAWING & subject.executables
    if given and draws and {"all", "graphics", "display"}.isdisjoint((said or "").split(",")):
        known = f"is {said}" if said else "is not set, unless by the image"
        message = f"{min(draws)} draws without the GPU: {NVIDIA[1]} {known}"
        yield Finding("gpu-without-graphics", subject.variable(NVIDIA[1]) if said else subject.command(), message)


def _files(subject: Subject) -> Iterator[Finding]:
    """Files and sockets that variables name, and no mount gives."""
    if subject.options.get("volumes_from"):
        return
    targets = [mount.target for mount in subject.mounts]
    for name in (name for name in FILES if name in subject.env):
        match = NAMED.match(subject.env[name])
        if match and not any(f"{match[1]}/".startswith(f"{target}/") for target in targets):
            message = f"{name} names {match[1]}, and no mount gives it: it is missing if the image lacks it, too"
            yield Finding("file-not-mounted", subject.variable(name), message)


CHECKS = (
    each(_gpus),
    *(in_containers(each(check)) for check in (_screens, _windows, _files)),
)
