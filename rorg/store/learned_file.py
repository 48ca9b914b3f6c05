"""The file `learned.json` of the state directory: what was learned about requests."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rorg.model.learned import Departure, Learned, Names
from rorg.store.files import read_state, write_atomic

NAME = "learned.json"
VERSION = 1
"""Of the file's format. Another format is ignored: rorg learns it again."""


def write_learned(folder: Path, learned: Learned) -> None:
    """Does not wait for the disk: what is lost with the power is learned again. Raises OSError."""
    departures = {
        requester: [{"asked": names, "departures": [[d.after, d.to] for d in ways]} for names, ways in states.items()]
        for requester, states in learned.departures.items()
    }
    content = {"version": VERSION, "departures": departures, "took": learned.took}
    write_atomic(folder / NAME, json.dumps(content) + "\n", durable=False)


def read_learned(folder: Path) -> Learned | None:
    """The habits written last; None if the file is missing or cannot be understood."""
    try:
        content = json.loads(read_state(folder / NAME))
        if content["version"] != VERSION:
            return None
        departures = {
            str(requester): {_names(state["asked"]): tuple(map(_departure, state["departures"])) for state in states}
            for requester, states in content["departures"].items()
        }
        took = {
            str(service): {str(verb): float(seconds) for verb, seconds in verbs.items()}
            for service, verbs in content["took"].items()
        }
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None
    return Learned(departures, took)


def _departure(said: Any) -> Departure:
    after, to = said
    return Departure(float(after), _names(to))


def _names(said: Any) -> Names:
    if not isinstance(said, list) or not all(isinstance(name, str) for name in said):
        raise TypeError(f"no list of names: {said!r}")
    return tuple(said)
