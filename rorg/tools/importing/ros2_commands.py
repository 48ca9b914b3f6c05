"""Command lines for the programs of ROS 2 launch files."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from typing import Any

from rorg.manifest.yaml_text import scalar
from rorg.tools.importing.launch_programs import Launch, Node, Process, Program
from rorg.tools.importing.launch_values import LATE, ParameterFile, mapped

_NOT_NUMBERS = ("nan", "inf", "infinity")
"""Texts that ROS 2 reads as numbers."""
_LAUNCHED = re.compile(r"\$\(find-pkg-share ([\w-]+)\)/launch/([^/$]+)")
_RUN = {
    "find-pkg-share": "ros2 pkg prefix --share {}",
    "find-pkg-prefix": "ros2 pkg prefix {}",
    "find-exec": "command -v {}",
}
"""Substitution that only the robot can resolve -> the command that prints its value."""


def ros_arguments(node: Node) -> list[str]:
    """The settings of a node, as its command line takes them."""
    words = [*node.ros_arguments]
    words += ["-r", f"__node:={node.name}"] if node.name else []
    words += ["-r", f"__ns:={node.namespace}"] if node.namespace else []
    for one in node.parameters:
        if isinstance(one, ParameterFile):
            words += ["--params-file", one.path]
        else:
            words += ["-p", f"{one.name}:={value_text(one.value)}"]
    for old, new in node.remaps:
        words += ["-r", f"{old}:={new}"]
    return ["--ros-args", *words] if words else []


def command(program: Program, file: str) -> list[str]:
    """The command of a service. `file`: where the container has the program's own launch file, if it needs one."""
    if file:
        words = ["ros2", "launch", file]
    elif isinstance(program, Launch):
        match = _LAUNCHED.fullmatch(program.file)
        words = ["ros2", "launch", *(match.groups() if match else [program.file]), *_assigned(program.scope.variables)]
    elif isinstance(program, Process):
        words = [*program.words]
    else:
        assert isinstance(program, Node)
        prefix = ["--prefix", program.prefix] if program.prefix else []
        start = ["ros2", "run", *prefix, program.package] if program.package else shlex.split(program.prefix)
        words = [*start, program.executable, *program.arguments, *ros_arguments(program)]
    exports = [f"export {name}={in_shell(value)}" for name, value in program.environment.items() if late(value)]
    if not exports and not any(map(late, words)):
        return words
    return ["sh", "-c", "; ".join([*exports, f"exec {' '.join(map(in_shell, words))}"])]


def late(text: str) -> bool:
    """Whether only the robot knows a part of a text."""
    return bool(LATE.search(text))


def in_shell(text: str) -> str:
    """A word for a shell that finds out what only the robot knows."""
    return mapped(text, shlex.quote, lambda match: f'"$({_RUN[match[1]].format(match[2])})"')


def value_text(value: Any) -> str:
    """A parameter as ROS 2 reads it from a command line, in YAML."""
    if isinstance(value, list):
        return f"[{', '.join(map(value_text, value))}]"
    if isinstance(value, str) and value.lower().lstrip("+-.") in _NOT_NUMBERS:
        return f'"{value}"'
    return scalar(value)


def _assigned(variables: Mapping[str, str]) -> list[str]:
    return [f"{name}:={value}" for name, value in variables.items()]
