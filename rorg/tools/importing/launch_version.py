"""Tells launch files of ROS 1 from those of ROS 2 by signs that only one of them has. Without a sign the package of the
file decides, and without a package a person."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from rorg.model.diagnostics import Diagnostic, Where
from rorg.tools.importing.launch_xml import Element

ROS2_SUFFIXES = (".py", ".yaml", ".yml")
"""Launch files of ROS 1 are always XML."""
TAGS = {
    **dict.fromkeys(("rosparam", "machine", "test", "master"), 1),
    **dict.fromkeys(("executable", "let", "node_container", "load_composable_node", "composable_node"), 2),
    **dict.fromkeys(("lifecycle_node", "push_ros_namespace", "push-ros-namespace", "timer", "log", "log_info"), 2),
    **dict.fromkeys(("set_env", "unset_env", "append_env", "set_parameter", "set_parameters_from_file"), 2),
    **dict.fromkeys(("set_remap", "set_use_sim_time", "reset", "ros_timer", "set_ros_log_dir"), 2),
}
"""Element -> the only ROS that has it."""
ATTRIBUTES = {
    **dict.fromkeys((("node", "type"), ("node", "ns"), ("node", "required"), ("node", "machine")), 1),
    **dict.fromkeys((("node", "clear_params"), ("include", "ns"), ("include", "pass_all_args")), 1),
    **dict.fromkeys((("include", "clear_params"), ("group", "ns"), ("group", "clear_params"), ("arg", "doc")), 1),
    **dict.fromkeys((("param", "command"), ("param", "textfile"), ("param", "binfile")), 1),
    **dict.fromkeys((("node", "exec"), ("node", "namespace"), ("node", "ros_args"), ("node", "exec_name")), 2),
    **dict.fromkeys((("param", "from"), ("group", "scoped"), ("group", "forwarding"), ("arg", "description")), 2),
}
"""(element, attribute) -> the only ROS that has it."""
TOP_LEVEL = {"param": 1, "remap": 1, "env": 1}
"""Directly below <launch> or <group> -> the only ROS that has it there."""
_SUBSTITUTION = re.compile(r"\$\((?:(arg|find|optenv)|(var|find-pkg-\w+|exec-in-pkg|find-exec|equals|command))\s")


@dataclass(frozen=True)
class Sign:
    """Signs that a file is one of ROS 1 or of ROS 2."""

    ros: int
    shown: str
    where: Where

    def __str__(self) -> str:
        return f"{self.shown} (line {self.where.line}) is of ROS {self.ros}"


def signs(top: Element) -> dict[int, Sign]:
    """The first sign of each ROS in a launch file."""
    found: dict[int, Sign] = {}
    for sign in _signs(top):
        found.setdefault(sign.ros, sign)
        if len(found) == 2:
            break
    return found


def _signs(top: Element) -> Iterator[Sign]:
    waiting = [(top, "")]
    while waiting:
        element, parent = waiting.pop()
        tag = element.tag
        if tag in TAGS:
            yield Sign(TAGS[tag], f"<{tag}>", element.where)
        elif parent in ("launch", "group") and tag in TOP_LEVEL:
            yield Sign(TOP_LEVEL[tag], f"<{tag}> outside of a node", element.where)
        for name, text in element.attributes.items():
            if (tag, name) in ATTRIBUTES:
                yield Sign(ATTRIBUTES[tag, name], f"`{name}` of <{tag}>", element.where)
            for match in _SUBSTITUTION.finditer(text):
                yield Sign(1 if match[1] else 2, f"$({match[1] or match[2]} ...)", element.where)
        waiting += [(child, tag) for child in reversed(element.children)]


def ros_of_package(text: str) -> int:
    """The ROS that a package.xml is for, by its build tool; 0 if it does not say."""
    if re.search(r"<build_type>\s*ament|<buildtool_depend>\s*ament_", text):
        return 2
    return 1 if re.search(r"<buildtool_depend>\s*catkin\s*<", text) else 0


def version(path: Path, top: Element, package: int) -> int | Diagnostic:
    """The ROS of a launch file in XML. `package`: the ROS of its package, 0 if that is not known."""
    found = signs(top)
    if len(found) == 1:
        return next(iter(found))
    if not found and package:
        return package
    why = f"{found[1]}, and {found[2]}" if found else "nothing in it is of only one of them"
    return Diagnostic(Where(str(path)), f"{path.name} may be of ROS 1 or of ROS 2: {why}", "`--ros 1` or `--ros 2`")


def other_ros(top: Element, ros: int) -> Diagnostic | None:
    """The error for an included file that is clearly one of the other ROS."""
    found = signs(top)
    if len(found) != 1 or ros in found:
        return None
    sign = next(iter(found.values()))
    return Diagnostic(sign.where, f"a launch file of ROS {ros} includes this one, but {sign}", f"one of ROS {ros}")
