"""Writes down what services go through: an entry for each state that a service comes into."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rorg.core.decide import Decision
from rorg.core.state_changes import NONE, state_changes
from rorg.model.units import counted


class Passages:
    """`write(kind, message, **more)` writes an entry."""

    def __init__(self, write: Callable[..., Any]) -> None:
        self.write = write
        self._states: dict[str, str] | None = None
        """As the journal has them; None before anything is known."""

    def note(self, decision: Decision) -> None:
        """Every decision that knows what is there must be noted."""
        first = self._states is None
        states = self._states = self._states or {}
        found = state_changes(states, decision)
        states.update({p.service: p.state for p in found})
        if first and found:
            # All in one: that they are as they are is no news of this moment.
            message = f"found {counted(len(found), 'service')} with a container"
            self.write("found", message, services=[p.service for p in found], states=dict(states))
            return
        for p in found:
            asked = {"requests": list(p.requests)} if p.requests else {}
            self.write("state", str(p), service=p.service, state=p.state, reason=p.reason, **asked)
            if p.state == NONE:
                del states[p.service]
