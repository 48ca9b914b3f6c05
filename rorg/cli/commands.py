"""The names of all commands, with their groups, summaries and modules. It imports none of them."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from keyword import iskeyword
from typing import Any

GROUPS = {
    "Start with": {
        "init": "Write a first robot, ready to run.",
        "demo": "Run a tour-guide robot of stand-in services.",
        "import": "Write manifests for a Compose project, systemd units or a launch file.",
        "run": "Run the loop that starts and stops services, until stopped.",
        "help": "Show the help of rorg, of a command, or of shared options.",
        "completion": "Print the completion script of a shell.",
    },
    "Every day": {
        "get": "List services with their state, or other objects.",
        "why": "Show why a service is active, or why it is not.",
        "request": "Request services.",
        "release": "End a request.",
        "wait": "Return when services are ready.",
        "restart": "Stop and start an active service.",
        "diff": "Show what rorg would do, and why, without doing it.",
        "apply": "Show the plan, ask, and carry it out.",
        "logs": "Print the logs of services.",
        "exec": "Run a command inside a service.",
        "shell": "Open a shell inside a service.",
    },
    "Look": {
        "describe": "Show everything about one service.",
        "explain": "Explain a manifest field, or every effective value of a service.",
        "events": "Show what happened.",
        "top": "Show what runs, what it uses and who asked for it.",
        "ui": "Show the robot in the browser.",
        "graph": "Show who needs and who requests whom.",
        "plot": "Draw a picture of the robot for a report.",
        "timeline": "Show the states of a service over time.",
        "doctor": "Check the installation and say what to do.",
    },
    "Change": {
        "edit": "Edit a manifest.",
        "validate": "Check manifests and report every mistake.",
        "build": "Build the images of the tree.",
        "hold": "Keep services idle for a time.",
        "suspend": "Change nothing for a time.",
        "retry": "Retry failed changes without editing anything.",
        "run-with": "Request services for as long as a command runs.",
        "down": "Stop and remove all services of this robot.",
    },
    "History": {
        "history": "List the revisions of the manifests.",
        "rollback": "Return to an earlier revision.",
        "restore": "Bring the robot back to an earlier time.",
    },
    "Robot parts": {
        "image": "List, prune, save or load the images that rorg has built.",
        "dev": "Open a shell in a service's own image, with your workspace.",
        "cp": "Copy files out of a service or into it.",
        "export": "Write the robot as a Compose file.",
        "fleet": "List the robots of a fleet.",
        "take": "Take services over from a machine that is gone.",
        "certificate": "Make the certificates of a robot's machines.",
    },
    "At a desk": {
        "simulate": "Replay a trace on a simulated robot in virtual time.",
        "emulate": "Replay a trace on a real engine with stand-in programs.",
        "trace": "Make traces of requests for simulate and emulate.",
        "fit": "Propose `resources:` for manifests from measured use.",
        "schema": "Write the JSON schemas of manifests, for editors.",
    },
}
"""Group of commands -> command -> its summary, in the order of the help."""
SUMMARIES = {name: summary for group in GROUPS.values() for name, summary in group.items()}
COMMANDS = tuple(SUMMARIES)
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
    module = (name if name in VARIANTS else ALIASES.get(name, name)).replace("-", "_")
    module += "_" * iskeyword(module)
    command: Callable[..., Any] = import_module(f"rorg.cli.{module}").command
    return command
