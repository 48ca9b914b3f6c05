"""The list of commands."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

COMMANDS = (
    "init",
    "validate",
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
    "hold",
    "suspend",
    "down",
    "wait",
    "events",
    "top",
    "logs",
    "graph",
    "build",
    "demo",
    "schema",
    "completion",
)
"""In the order of the help."""


def command_of(name: str) -> Callable[..., Any]:
    """The function of a command."""
    from importlib import import_module

    found: Callable[..., Any] = import_module(f"rorg.cli.{name.replace('-', '_')}").command
    return found
