"""What an event of the engine says about a container."""

from __future__ import annotations

import signal
from collections.abc import Mapping
from typing import Any

from rorg.engines.protocol import SIGNALLED

TOLD = {"pause": "paused", "unpause": "running"}
"""Events that tell the whole change, so that the container need not be inspected."""
QUIET = ("exec_", "health_status", "attach", "top", "resize", "copy", "export")
"""Beginnings of events that change nothing that rorg looks at."""
ENDING = {str(int(number)) for number in (signal.SIGINT, signal.SIGQUIT, signal.SIGKILL, signal.SIGTERM)}
"""Signals by which people and their tools end a program, as the engine's events name them."""


def is_quiet(event: Mapping[str, Any]) -> bool:
    """Return whether nothing that rorg looks at has changed."""
    return str(event.get("Action", "")).startswith(QUIET)


def told_state(event: Mapping[str, Any]) -> str:
    """Return the new state of the container; SIGNALLED; "" if only inspection can tell."""
    action, attributes = event.get("Action", ""), event["Actor"].get("Attributes") or {}
    return SIGNALLED if action == "kill" and attributes.get("signal") in ENDING else TOLD.get(action, "")
