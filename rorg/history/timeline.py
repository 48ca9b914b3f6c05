"""Makes a timeline of a service from entries of the journal: spans of time, each with a state, why, and who asked."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from rorg.model.units import parse_time

ENDED = {"exited": "stop", "paused": "pause", "none": "remove"}
"""States, and the actions that end in them."""
Author = Callable[[str, str, str], str]
"""(requester, id, time) -> who last made or released that request by then; empty if that is not known."""


@dataclass(frozen=True, slots=True)
class Span:
    """A time in one state. Times are ISO 8601 in UTC."""

    state: str
    begin: str
    end: str
    why: str = ""
    who: str = ""
    failed: bool = False
    """Whether it ended in this state unexpectedly."""
    open: bool = False
    """Whether it is not over yet."""

    def as_json(self) -> dict[str, Any]:
        return {
            "state": self.state,
            "begin": self.begin,
            "end": None if self.open else self.end,
            "seconds": round(max(0.0, parse_time(self.end) - parse_time(self.begin)), 3),
            "why": self.why,
            "who": self.who,
            "failed": self.failed,
        }


def spans(service: str, entries: Iterable[Mapping[str, Any]], begin: str, end: str, author: Author) -> list[Span]:
    """Spans from `begin` to `end`, as far as states are on record. `entries` are about the service, with the one that
    tells its state at the beginning."""
    timeline, told = list[Span](), _Told()
    for entry in entries:
        state = _state(service, entry)
        if not state:
            told.note(service, entry)
            if entry["kind"] == "crashed" and timeline and timeline[-1].state == "exited":
                timeline[-1] = replace(timeline[-1], failed=True)  # the state was on record before its cause
        elif not timeline or state != timeline[-1].state:
            at = max(begin, entry["at"])
            timeline[-1:] = [replace(last, end=at) for last in timeline[-1:] if last.begin != at]
            failed = state == "exited" and (told.crashed or bool(entry.get("failed")))
            timeline.append(Span(state, at, end, told.why(entry, state), told.who(entry, state, author), failed))
    timeline[-1:] = [replace(last, open=True) for last in timeline[-1:]]
    return timeline


def _state(service: str, entry: Mapping[str, Any]) -> str:
    """The state that an entry reports of the service; empty if it reports none."""
    if entry["kind"] == "found":
        return str(entry.get("states", {}).get(service, ""))
    return str(entry.get("state", "")) if entry["kind"] == "state" and entry.get("service") == service else ""


class _Told:
    """The cause of a state, from the entries before it."""

    def __init__(self) -> None:
        self.asked = ""
        """Who restarted or held the service, until it is ready again."""
        self.requests: list[str] = []
        """Those that it was in the previous state for."""
        self.crashed = False
        self.done: Mapping[str, Any] = {}
        """The last action."""

    def note(self, service: str, entry: Mapping[str, Any]) -> None:
        if entry.get("author") and service in entry.get("services", ()):
            self.asked = entry["author"]
        elif entry["kind"] == "crashed":
            self.crashed = True
        elif entry["kind"] == "done":
            self.done = entry

    def why(self, entry: Mapping[str, Any], state: str) -> str:
        if entry["kind"] == "found":
            return "already so when rorg began"
        # The reason of the action that ended a state says more than why the service is wanted.
        ended = self.done.get("verb") == ENDED.get(state, "") and not self.crashed
        return str((self.done if ended else entry).get("reason", ""))

    def who(self, entry: Mapping[str, Any], state: str, author: Author) -> str:
        asked, crashed, before = self.asked, self.crashed, self.requests
        self.asked, self.crashed = "" if state == "ready" else asked, False
        self.requests = entry.get("requests", [])
        requests = self.requests or before
        if asked or crashed or not requests:
            return "" if crashed else asked
        requester, _, id = requests[0].partition("/")
        return author(requester, id, entry["at"]) or requester
