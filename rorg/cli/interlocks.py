"""Says which services wait for their interlock after an order of a person, who would otherwise wait for nothing."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping
from typing import Any

from rorg.cli.output import note
from rorg.model.codes import INTERLOCK

SURE = 1.0
"""Seconds of refusal, or without an answer, after which it is reported: an interlock that allows it has done so."""
LOOK = 0.05


def locked(view: Mapping[str, Any]) -> dict[str, str]:
    """Return the services of a view (StatusView) that wait for their interlock -> its answer."""
    return {w["service"]: w["reason"] for w in view["plan"]["waitings"] if w.get("code") == INTERLOCK}


class Interlocks:
    """Reports each service once. `known` are those that waited before the order."""

    def __init__(self, known: Collection[str] = ()) -> None:
        self._reported = set(known)
        self._since: dict[str, float] = {}

    def see(self, refusals: Mapping[str, str]) -> bool:
        """Take what locked() returns, and report what has lasted for SURE. Return whether something has not yet."""
        now = time.monotonic()
        self._since = {name: self._since.get(name, now) for name in refusals if name not in self._reported}
        for name, since in self._since.items():
            if now - since >= SURE:
                self._reported.add(name)
                note(
                    f"{name} waits ({refusals[name]}); rorg goes on when the interlock allows it, "
                    "or when you remove the interlock from the manifests"
                )
        return not self._reported.issuperset(refusals)


def report_locked(look: Callable[[], Mapping[str, str]], known: Collection[str]) -> None:
    """Report services that an order concerns and that wait for their interlock; `look` returns what locked() does.
    Returns immediately if none waits."""
    interlocks = Interlocks(known)
    while interlocks.see(look()):
        time.sleep(LOOK)
