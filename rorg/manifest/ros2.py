"""What `ros` of a Service means for a program of ROS 2: environment, arguments, and a file of parameters.

The parameters are in a file of rorg's, which the program reads whenever it starts. So a changed value needs no new
container, and the next run has it even if the program reads its parameters only once.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rorg.manifest.documents import Source
from rorg.manifest.ros import Ros
from rorg.model.diagnostics import Diagnostic
from rorg.model.ros import PARAMETER_FILE, without_master
from rorg.model.run_directory import parameter_folder

SHELLS = frozenset(("sh", "bash", "dash", "zsh"))
MARK = "--ros-args"


def programs_of(*commands: Sequence[str] | None) -> list[str]:
    """Returns the names of all programs and words in command lines."""
    return [word.rpartition("/")[2] for command in commands for word in " ".join(command or ()).split()]


def domain_of(container: Mapping[str, Any]) -> int | None:
    """Returns the domain of a program of ROS 2; None for all others, for which rorg asks the ROS 1 master."""
    environment = container.get("environment", {})
    programs = programs_of(container.get("entrypoint"), container.get("command"))
    if not without_master(environment, str(container.get("image") or ""), programs):
        return None
    domain = str(environment.get("ROS_DOMAIN_ID") or "0")
    return int(domain) if domain.isdigit() else 0


def environment_of(ros: Ros) -> dict[str, str]:
    """Returns the variables that `ros` sets."""
    domain = {} if ros.domain is None else {"ROS_DOMAIN_ID": str(ros.domain)}
    return {**domain, **({"RMW_IMPLEMENTATION": ros.rmw} if ros.rmw else {})}


def with_arguments(source: Source, container: dict[str, Any]) -> Iterator[Diagnostic]:
    """Adds the arguments that `ros` stands for to the container's command, and the file of parameters that they
    name."""
    ros: Ros | None = source.spec.ros
    if ros is None or domain_of(container) is None:
        return
    arguments = _arguments(source.name, ros)
    if not arguments:
        return
    command = container.get("command") or ()
    if why := _takes_none(command):
        where = source.where("spec", "ros")
        yield Diagnostic(where, f"cannot hand names and parameters to this program: {why}", "a command of one node")
        return
    if ros.parameters:
        folder = parameter_folder(source.name)
        container["volumes"] = [*container.get("volumes", ()), f"{folder}:{folder}:ro"]
    container["command"] = [*command, MARK, *arguments]


def _arguments(name: str, ros: Ros) -> list[str]:
    renamed = [*({"__ns": ros.namespace} if ros.namespace else {}).items(), *ros.remap.items()]
    files = [*ros.parameter_files, *([f"{parameter_folder(name)}/{PARAMETER_FILE}"] if ros.parameters else [])]
    return [
        *(word for before, after in renamed for word in ("--remap", f"{before}:={after}")),
        *(word for file in files for word in ("--params-file", file)),
    ]


def _takes_none(command: Sequence[str]) -> str:
    """Returns why a command does not hand arguments on to a node; "" if it does."""
    if not command:
        return "its command is not declared"
    program = command[0].rpartition("/")[2]
    if program in SHELLS and "-c" in command:
        return "a shell runs it"
    return "ros2 launch does not hand them on" if program == "ros2" and command[1:2] == ["launch"] else ""
