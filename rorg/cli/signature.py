"""What a command takes, read from the signature of its function."""

from __future__ import annotations

import os
import types
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_args, get_origin, get_type_hints

from rorg.cli.context import ROBOT as ROBOT_VARIABLE
from rorg.cli.context import Context
from rorg.cli.options import (
    DIRECTORY,
    MANIFESTS,
    ON_MACHINE,
    ROBOT,
    SOCKET,
    STATE_DIR,
    Argument,
    ContextOptions,
    Option,
)
from rorg.cli.places import socket_of
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

    @property
    def takes_next(self) -> bool:
        """Whether the next word is its value, if it has none after a `=`."""
        return not self.flag and not (isinstance(self.declared, Option) and self.declared.bare)


def parameters(command: Callable[..., Any]) -> tuple[Parameter, ...]:
    """What a command line may give a command: the parameters of its function in order, then those of its context."""
    # Not inspect.signature: its import takes a tenth of a short command.
    code = command.__code__
    names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
    hints = get_type_hints(command, include_extras=True)
    contexts = _contexts(hints)
    defaults = dict(zip(reversed(names[: code.co_argcount]), reversed(command.__defaults__ or ()), strict=False))
    defaults |= command.__kwdefaults__ or {}
    own = [name for name in names if name not in contexts]
    parameters = [_parameter(name, hints[name], name not in defaults, defaults.get(name)) for name in own]
    parameters += [_parameter(name, hint) for options in contexts.values() for name, hint in options.hints.items()]
    if any(p.declared in (DIRECTORY, MANIFESTS) for p in parameters):
        parameters.append(_ROBOT)
    if any(p.declared is STATE_DIR for p in parameters):
        parameters += [_SOCKET, _ON]
    return tuple(parameters)


def call(command: Callable[..., Any], values: dict[str, Any]) -> None:
    """Calls a command with its values, and its context made of theirs. `--socket`, `--on` and `--robot` go into the
    environment, for everything that looks for rorg or reads manifests, and for programs that the command starts. Raises
    Invalid if two places are given."""
    if robot := values.pop(_ROBOT.name, None):
        os.environ[ROBOT_VARIABLE] = robot
    if socket := values.pop(_SOCKET.name, None):
        if values.get("state_dir"):
            raise Invalid("look in two places", "--socket and --state-dir each name one", "one of them")
        os.environ["RORG_SOCKET"] = str(socket)
    if machine := values.pop(_ON.name, None):
        os.environ["RORG_SOCKET"], values["state_dir"] = socket_of(machine, values.get("state_dir")), None
    for name, options in _contexts(get_type_hints(command, include_extras=True)).items():
        given = {option: values.pop(option) for option in options.hints}
        values[name] = Context(**given, local=options.local, own=options.own)
    command(**values)


def _contexts(hints: dict[str, Any]) -> dict[str, ContextOptions]:
    """The parameter that takes a command's context, if one does."""
    declared = {name: get_args(hint)[-1] for name, hint in hints.items() if get_args(hint)}
    return {name: options for name, options in declared.items() if isinstance(options, ContextOptions)}


def parted(declared: Sequence[Parameter], words: Sequence[str]) -> tuple[list[str], dict[str, list[str]]]:
    """The words before `--`, and those after it by the name of the parameter that takes them."""
    rest = next((p.name for p in declared if p.rest), None)
    if rest is None:
        return list(words), {}
    end = words.index("--") if "--" in words else len(words)
    return list(words[:end]), {rest: list(words[end + 1 :])}


def _parameter(name: str, hint: Any, required: bool = False, default: Any = None) -> Parameter:
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


_SOCKET = _parameter("socket", Annotated[Path | None, SOCKET])
_ON = _parameter("on_machine", Annotated[str | None, ON_MACHINE])
_ROBOT = _parameter("robot", Annotated[str | None, ROBOT])
"""Parameters that commands have without declaring them."""
