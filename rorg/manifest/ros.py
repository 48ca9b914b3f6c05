"""`ros` of a Service: its parameters, and for ROS 2 its names, middleware and managed nodes."""

from __future__ import annotations

import math
import re
from typing import Annotated, Any

from pydantic import AfterValidator, Field, WithJsonSchema, model_validator

from rorg.manifest.fields import Written, recreate, unchanging
from rorg.manifest.option_forms import Strict

NAME = r"^(/[A-Za-z_][A-Za-z0-9_]*)+$"
"""An absolute name in the ROS graph: https://wiki.ros.org/Names."""
FILE = "file"
UNSENDABLE = re.compile(r"[^\t\n\r\x20-\uD7FF\uE000-\uFFFD\U00010000-\U0010FFFF]")
"""Characters that XML 1.0 cannot carry."""


def _absolute(name: str) -> str:
    if not re.fullmatch(NAME, name):
        raise ValueError("must be an absolute name of ROS, such as /move_base/max_vel")
    return name


def sendable(value: Any) -> Any:
    """Returns the value of a parameter unchanged. Raises ValueError if XML-RPC cannot carry it: it has integers of 32
    bits, and no null."""
    if isinstance(value, bool):
        return value
    if isinstance(value, int) and not -(1 << 31) <= value < 1 << 31:
        raise ValueError(f"{value} has more than the 32 bits of a ROS parameter; write it as {value}.0, or as a text")
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"a ROS parameter cannot be {value}")
    if isinstance(value, str) and UNSENDABLE.search(value):
        raise ValueError("a ROS parameter cannot hold control characters")
    if isinstance(value, dict):
        if not all(isinstance(key, str) and not UNSENDABLE.search(key) for key in value):
            raise ValueError("the keys of a mapping must be text")
        return {key: sendable(item) for key, item in value.items()}
    if isinstance(value, list):
        return [sendable(item) for item in value]
    if not isinstance(value, bool | int | float | str):
        raise ValueError("must be true, false, a number, a text, a list, a mapping, or {file: PATH}")
    return value


ParameterName = Annotated[str, AfterValidator(_absolute), WithJsonSchema({"type": "string", "pattern": NAME})]
Parameter = Annotated[
    Any,
    AfterValidator(sendable),
    WithJsonSchema({"type": ["boolean", "number", "string", "array", "object"]}),
    Written("any value, or {file: PATH}"),
]


NodeName = Annotated[str, AfterValidator(_absolute), WithJsonSchema({"type": "string", "pattern": NAME})]
RELATIVE = r"^[~/]?[A-Za-z0-9_/{}~]+$"
Renamed = Annotated[str, Field(pattern=RELATIVE)]


class Ros(Strict):
    """Settings of a ROS program. Except for `parameters`, they need ROS 2."""

    parameters: dict[ParameterName, Parameter] = unchanging(
        "Parameters by absolute name. In ROS 1 they are set at the master, before each start of the service and again "
        "after each restart of its master. In ROS 2 the last part of the name is the parameter, the rest is the node; "
        "the program reads them when it starts. {file: PATH} is the text of a file beside the manifest. A changed "
        "value is set immediately.",
        {"/robot_name": "freight", "/robot_description": {"file": "./urdf/robot.urdf"}},
        dict,
    )
    lifecycle: Annotated[list[NodeName], Field(max_length=64)] = unchanging(
        "Managed nodes that rorg configures and activates when the service is wanted, in this order. It is ready only "
        "when all are active. `idle: {action: deactivate}` deactivates them in the opposite order.",
        ["/map_server", "/amcl"],
        list,
    )
    parameter_files: list[Annotated[str, Field(min_length=1)]] = recreate(
        "Files of parameters inside the container, for --params-file. Later ones override earlier ones.",
        ["/robot/nav2.yaml"],
        list,
    )
    remap: dict[Renamed, Renamed] = recreate("Names to replace, for --remap.", {"scan": "/front/scan"}, dict)
    namespace: Renamed | None = recreate("Namespace of its nodes, for --remap __ns:=.", "/arm")
    domain: Annotated[int, Field(ge=0, le=232)] | None = recreate("ROS_DOMAIN_ID.", 7, unset="the profile's")
    rmw: Annotated[str, Field(pattern=r"^rmw_[a-z0-9_]+$")] | None = recreate(
        "RMW_IMPLEMENTATION.", "rmw_cyclonedds_cpp", unset="the profile's"
    )

    @model_validator(mode="after")
    def _apart(self) -> Ros:
        for name in self.parameters:
            above = next((other for other in self.parameters if name.startswith(f"{other}/")), "")
            if above:
                raise ValueError(f"{name} is part of {above}, which is declared too: keep one of them")
        return self


def file_of(value: Any) -> str:
    """The path that a parameter's value names; empty if it is a plain value."""
    named = value[FILE] if isinstance(value, dict) and value.keys() == {FILE} else ""
    return named if isinstance(named, str) else ""
