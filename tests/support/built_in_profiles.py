"""What the built-in profiles give a service."""

from __future__ import annotations

BUILT_IN = ("ros1", "ros2", "plain", "realtime", "gpu", "x11")

GIVES = {
    "ros1": ("container.environment.ROS_MASTER_URI", "http://localhost:11311"),
    "ros2": ("container.ipc", "host"),
    "plain": (),
    "realtime": ("container.cap_add[0]", "SYS_NICE"),
    "gpu": ("container.gpus[0]", {"count": "all"}),
    "x11": ("container.environment.DISPLAY", ":0"),
}
