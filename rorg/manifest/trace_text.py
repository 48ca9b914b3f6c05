"""A trace as the text of its file: what read_trace reads back as the same."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from rorg.manifest.yaml_text import Inline, yaml_text
from rorg.model.trace import Trace, TraceEvent
from rorg.model.units import format_duration


def trace_text(trace: Trace) -> str:
    """YAML with a line an event. Raises ValueError where two states of one name request different services."""
    behaviour, states = _behaviour(trace), _states(trace)
    metadata = {"name": trace.name, **({"description": trace.description} if trace.description else {})}
    spec: dict[str, Any] = {"duration": _length(trace.duration)}
    if behaviour != "developer":
        spec["behaviour"] = behaviour
    if states:
        spec["states"] = {state: list(services) for state, services in states.items()}
    spec["events"] = [Inline(_entry(event, behaviour)) for event in trace.events]
    return yaml_text({"apiVersion": "rorg/v1", "kind": "Trace", "metadata": metadata, "spec": spec})


def _behaviour(trace: Trace) -> str:
    """Whose states most of them are."""
    most = Counter(event.requester for event in trace.events if event.state).most_common(1)
    return most[0][0] if most else "developer"


def _states(trace: Trace) -> Mapping[str, tuple[str, ...]]:
    found = dict[str, tuple[str, ...]]()
    for event in trace.events:
        if event.state and found.setdefault(event.state, event.services) != event.services:
            raise ValueError(f"state '{event.state}' requests one thing at first, and another at {event.at:g} s")
    return found


def _entry(event: TraceEvent, behaviour: str) -> dict[str, Any]:
    entry: dict[str, Any] = {"at": format_duration(event.at)}
    if event.state:
        entry["state"] = event.state
    elif event.services:
        entry |= {"request": event.id, "services": list(event.services)}
    else:
        entry["release"] = event.id
    if event.requester != (behaviour if event.state else "developer"):
        entry["by"] = event.requester
    return entry


def _length(seconds: float) -> str:
    """In the largest unit of which it is a whole number."""
    for unit, size in (("h", 3600), ("m", 60)):
        if seconds and seconds % size == 0:
            return f"{seconds / size:.0f}{unit}"
    return format_duration(seconds)
