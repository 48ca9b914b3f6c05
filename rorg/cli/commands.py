"""The names of all commands, and their modules."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

COMMANDS = (
    "init",
    "certificate",
    "import",
    "validate",
    "doctor",
    "diff",
    "apply",
    "run",
    "get",
    "describe",
    "why",
    "explain",
    "request",
    "release",
    "run-with",
    "restart",
    "retry",
    "take",
    "hold",
    "suspend",
    "down",
    "wait",
    "events",
    "history",
    "fleet",
    "rollback",
    "restore",
    "timeline",
    "trace",
    "top",
    "ui",
    "logs",
    "exec",
    "shell",
    "cp",
    "graph",
    "plot",
    "simulate",
    "edit",
    "fit",
    "build",
    "image",
    "export",
    "dev",
    "demo",
    "emulate",
    "schema",
    "completion",
)
"""In the order of the help."""

ALIASES = {
    "ps": "get",
    "ls": "get",
    "status": "get",
    "up": "run",
    "start": "request",
    "stop": "release",
    "pull": "build",
    "stats": "top",
}
"""Words of Docker and systemd for commands of rorg. `up` is the counterpart of `down`, as with Compose."""


VARIANTS = ("stop",)
"""Aliases with a file of their own, because they check more than the command that they stand for."""


def command_of(name: str) -> Callable[..., Any]:
    """The function of a command, by its name or an alias."""
    from importlib import import_module
    from keyword import iskeyword

    module = (name if name in VARIANTS else ALIASES.get(name, name)).replace("-", "_")
    module += "_" * iskeyword(module)
    command: Callable[..., Any] = import_module(f"rorg.cli.{module}").command
    return command
