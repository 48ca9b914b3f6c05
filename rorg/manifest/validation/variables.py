"""Names that are most likely misspelt: variables of ROS, and images of the tree."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator
from functools import lru_cache

from rorg.manifest.images import ALIKE as ALIKE_IMAGE
from rorg.manifest.validation.robot import Finding, Robot, each
from rorg.manifest.validation.subject import Subject
from rorg.model.diagnostics import close_to
from rorg.model.image_names import declared, plain

ALIKE = 0.86
"""Similarity (of difflib) above which a name counts as a misspelt known one."""
_KNOWN = """
ROS_MASTER_URI ROS_HOSTNAME ROS_IP ROS_NAMESPACE ROS_LOG_DIR ROS_HOME ROS_PACKAGE_PATH ROS_DISTRO ROS_VERSION
ROS_PYTHON_VERSION ROS_ETC_DIR ROS_ROOT ROS_DOMAIN_ID ROS_LOCALHOST_ONLY ROS_AUTOMATIC_DISCOVERY_RANGE
ROS_STATIC_PEERS ROS_DISCOVERY_SERVER ROS_SUPER_CLIENT ROS_SECURITY_ENABLE ROS_SECURITY_KEYSTORE ROS_SECURITY_STRATEGY
RMW_IMPLEMENTATION RCUTILS_COLORIZED_OUTPUT RCUTILS_CONSOLE_OUTPUT_FORMAT RCUTILS_LOGGING_BUFFERED_STREAM
RCUTILS_LOGGING_USE_STDOUT ROSCONSOLE_FORMAT ROSCONSOLE_CONFIG_FILE FASTRTPS_DEFAULT_PROFILES_FILE
FASTDDS_DEFAULT_PROFILES_FILE FASTDDS_BUILTIN_TRANSPORTS CYCLONEDDS_URI AMENT_PREFIX_PATH CMAKE_PREFIX_PATH"""
KNOWN = tuple(_KNOWN.split())
QUOTED = re.compile(r"\"[^\"]*\"|'[^']*'")
BEGINS = ("RO", "RM", "RSO", "RC", "FAST", "CYC", "AMENT", "CMAKE")
RMW = (
    *("rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp", "rmw_cyclonedds_cpp", "rmw_connextdds", "rmw_connext_cpp"),
    *("rmw_gurumdds_cpp", "rmw_zenoh_cpp"),
)


def _names(subject: Subject) -> Iterator[Finding]:
    for name in sorted(set(subject.env) - set(KNOWN)):
        close = _like(name)
        if close and close not in subject.env:
            message = f"nothing reads {name}; {close} is a variable of ROS"
            yield Finding("misspelt-variable", subject.variable(name), message, close)


@lru_cache(maxsize=2048)
def _like(name: str) -> str:
    """The variable of ROS that was probably meant; empty if there is none."""
    if not name.startswith(BEGINS) or name.startswith("RORG_"):
        return ""
    return next(iter(difflib.get_close_matches(name, KNOWN, 1, ALIKE)), "")


def _quotes(subject: Subject) -> Iterator[Finding]:
    """Values in quotes, which only a shell or a dotenv file would remove."""
    for name in sorted(name for name, value in subject.env.items() if QUOTED.fullmatch(value)):
        message = f"the value of {name} begins and ends with a quotation mark, which is part of it"
        yield Finding("quoted-variable", subject.variable(name), message)


def _implementations(robot: Robot) -> Iterator[Finding]:
    for subject in robot.ros2:
        value = subject.env.get("RMW_IMPLEMENTATION", "")
        close = difflib.get_close_matches(value, RMW, 1, 0.7)
        if value and value not in RMW and close and not QUOTED.fullmatch(value):
            message = f"there is no RMW implementation '{value}'"
            yield Finding("misspelt-rmw", subject.variable("RMW_IMPLEMENTATION"), message, close[0])


def _images(robot: Robot) -> Iterator[Finding]:
    images = robot.catalog.images
    for subject in robot.subjects:
        name = str(subject.options.get("image") or "")
        if not images or declared(name, images) or "/" in name or ":" in plain(name):
            continue
        if close := close_to(name, images, ALIKE_IMAGE):
            message = f"'{name}' is not an Image of this tree and would be pulled"
            yield Finding("misspelt-image", subject.at("image"), message, f"'{close}'")


CHECKS = (_implementations, _images, *map(each, (_names, _quotes)))
