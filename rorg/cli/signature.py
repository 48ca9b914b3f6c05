"""What a command takes, read from the signature of its function."""

from __future__ import annotations

import os
import types
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, get_args, get_origin, get_type_hints

from rorg.cli.options import DIRECTORY, MANIFESTS, ROBOT, SOCKET, STATE_DIR, Argument, Option
from rorg.errors import Invalid


class Parameter(NamedTuple):
    """One parameter of a command. `type` is that of a single value; `many`: it is a list of them."""

    name: str
    declared: Argument | Option
    hint: Any
    type: Any
    many: bool
    required: bool
    default: Any

    @property
    def rest(self) -> bool:
        """Whether it takes all words after `--`."""
        return isinstance(self.declared, Argument) and self.declared.rest

    @property
    def flag(self) -> bool:
        """Whether it is an option without a value."""
        return self.type is bool


def parameters(command: Callable[..., Any]) -> tuple[Parameter, ...]:
    """The parameters of a command, in order."""
    # Not inspect.signature: its import takes a tenth of a short command.
    code, defaults = command.__code__, command.__defaults__ or ()
    names = code.co_varnames[: code.co_argcount]
    hints = get_type_hints(command, include_extras=True)
    first = len(names) - len(defaults)
    found = tuple(
        _parameter(name, hints[name], i < first, None if i < first else defaults[i - first])
        for i, name in enumerate(names)
    )
    robot = (_ROBOT,) if any(p.declared in (DIRECTORY, MANIFESTS) for p in found) else ()
    socket = (_SOCKET,) if any(p.declared is STATE_DIR for p in found) else ()
    return (*found, *robot, *socket)


def call(command: Callable[..., Any], values: dict[str, Any]) -> None:
    """Calls a command with its values. `--socket` and `--robot` go into the environment, for everything that looks for
    rorg or reads manifests, and for programs that the command starts. Raises Invalid if two places are given."""
    robot = values.pop(_ROBOT.name, None)
    if robot:
        os.environ["RORG_ROBOT"] = robot
    socket = values.pop(_SOCKET.name, None)
    if socket:
        if values.get("state_dir"):
            raise Invalid("look in two places", "--socket and --state-dir each name one", "one of them")
        os.environ["RORG_SOCKET"] = str(socket)
    command(**values)


def parted(declared: Sequence[Parameter], words: Sequence[str]) -> tuple[list[str], dict[str, list[str]]]:
    """The words before `--`, and those after it by the name of the parameter that takes them."""
    rest = next((p.name for p in declared if p.rest), None)
    if rest is None:
        return list(words), {}
    end = words.index("--") if "--" in words else len(words)
    return list(words[:end]), {rest: list(words[end + 1 :])}


def _parameter(name: str, hint: Any, required: bool, default: Any) -> Parameter:
    plain, declared = get_args(hint)
    single = next(a for a in get_args(plain) if a is not type(None)) if isinstance(plain, types.UnionType) else plain
    many = get_origin(single) is list
    if isinstance(declared, Option) and not declared.names:
        declared = declared._replace(names=(f"--{name.replace('_', '-')}",))
    return Parameter(
        name=name,
        declared=declared,
        hint=plain,
        type=get_args(single)[0] if many else single,
        many=many,
        required=required,
        default=default,
    )


_SOCKET = Parameter(
    name="socket", declared=SOCKET, hint=Path | None, type=Path, many=False, required=False, default=None
)
_ROBOT = Parameter(name="robot", declared=ROBOT, hint=str | None, type=str, many=False, required=False, default=None)
"""Parameters that commands have without declaring them."""
