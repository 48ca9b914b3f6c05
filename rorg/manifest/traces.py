"""Reads and writes files of a trace: a document of kind Trace, which is not part of a tree. Simulating commands read
it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from rorg.manifest.fields import Written, field
from rorg.manifest.one_document import OneDocument, read_document
from rorg.manifest.option_forms import Duration, Name, Strict
from rorg.manifest.yaml_text import Inline, yaml_text
from rorg.model.diagnostics import Diagnostic, Reading, nearest, unknown
from rorg.model.trace import Trace, TraceEvent
from rorg.model.units import format_duration

Services = Annotated[list[Name], Field(min_length=1)]


class TraceEntry(Strict):
    """An event. Exactly one of state, request, release."""

    at: Duration = field("When, since the trace began. No earlier than the entry before.", "12.5s", ...)
    state: str | None = field("A state that the behaviour enters: one of `states`.", "tour")
    request: Name | None = field("The id of a new or changed request.", "look")
    release: Name | None = field("The id of a request to release.", "look")
    services: Services | None = field("The requested services and groups.", ["usb_cam"])
    by: Name | None = field(
        "The requester, or the service of the behaviour.",
        "behavioral",
        unset="developer; of a state the trace's `behaviour`",
    )

    @model_validator(mode="after")
    def _one(self) -> TraceEntry:
        if sum(v is not None for v in (self.state, self.request, self.release)) != 1:
            raise ValueError("exactly one of state, request, release must be given")
        if (self.request is None) != (self.services is None):
            raise ValueError("request and services belong together")
        return self


class TraceSpec(Strict):
    """Requests to a robot over some time."""

    duration: Duration = field("How long it lasts.", "4h", ...)
    behaviour: Name = field("The service whose states these are.", "behavioral", "developer")
    states: Annotated[dict[str, list[Name]], Written("mapping of lists of names")] = field(
        "The requests of the behaviour in each of its states.", {"tour": ["navigation"], "charging": []}, dict
    )
    events: list[TraceEntry] = field("The events, in order of time.", [{"at": "5s", "state": "tour"}], ...)


def read_trace(path: Path, known: Collection[str] | None = None) -> Trace:
    """Reads a trace. `known` are the services and groups of its robot; None skips the check of names. Raises Invalid
    with all mistakes, each with file:line:column."""
    return read_document(path, "Trace", TraceSpec, lambda found: _trace(found, known))


def _trace(source: OneDocument[TraceSpec], known: Collection[str] | None) -> Reading[Trace]:
    if known is not None:
        yield from _unknown(source, known)
    spec, events, before = source.spec, list[TraceEvent](), 0.0
    held: set[tuple[str, str]] = set()
    for index, entry in enumerate(spec.events):
        where, path = source.document.where, ("spec", "events", index)
        if entry.at < before:
            yield Diagnostic(
                where((*path, "at")), f"it comes after an entry of {before:g} s", "to order entries by time"
            )
        if entry.at > spec.duration:
            what = f"after the end of the trace, {spec.duration:g} s"
            yield Diagnostic(where((*path, "at")), what, "a longer duration")
        before = max(before, entry.at)
        if entry.state is not None and entry.state not in spec.states:
            yield unknown(where((*path, "state")), "state", entry.state, spec.states)
        event = _event(spec, entry)
        if entry.release is not None and (event.requester, event.id) not in held:
            yield Diagnostic(where((*path, "release")), f"{event.requester} holds no request '{event.id}' then")
        (held.add if event.services else held.discard)((event.requester, event.id))
        events.append(event)
    return Trace(source.name, spec.duration, tuple(events), source.description)


def _event(spec: TraceSpec, entry: TraceEntry) -> TraceEvent:
    if entry.state is not None:
        who = entry.by or spec.behaviour
        return TraceEvent(entry.at, who, who, tuple(spec.states.get(entry.state, ())), entry.state)
    who = entry.by or "developer"
    return TraceEvent(entry.at, who, entry.request or entry.release or "", tuple(entry.services or ()))


def _unknown(source: OneDocument[TraceSpec], known: Collection[str]) -> Iterator[Diagnostic]:
    """Reports names that the robot does not have, at every place."""
    spec, names = source.spec, {*known, "developer"}
    places = list[tuple[str, tuple[str | int, ...]]]([(spec.behaviour, ("behaviour",))])
    for state, services in spec.states.items():
        places += [(name, ("states", state, index)) for index, name in enumerate(services)]
    for index, entry in enumerate(spec.events):
        places += [(name, ("events", index, "services", i)) for i, name in enumerate(entry.services or ())]
        places += [(entry.by, ("events", index, "by"))] if entry.by else []
    for name, path in places:
        if name not in names:
            what = f"no service or group '{name}'"
            yield Diagnostic(source.document.where(("spec", *path)), what, nearest(name, names))


def trace_text(trace: Trace) -> str:
    """Writes a trace as YAML with one line per event, so that read_trace reads the same. Raises ValueError if one state
    requests different services at different times."""
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
    """The requester with the most states."""
    most = Counter(event.requester for event in trace.events if event.state).most_common(1)
    return most[0][0] if most else "developer"


def _states(trace: Trace) -> Mapping[str, tuple[str, ...]]:
    states = dict[str, tuple[str, ...]]()
    for event in trace.events:
        if event.state and states.setdefault(event.state, event.services) != event.services:
            raise ValueError(f"state '{event.state}' requests one thing at first, and another at {event.at:g} s")
    return states


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
    """In the largest unit that gives a whole number."""
    for unit, size in (("h", 3600), ("m", 60)):
        if seconds and seconds % size == 0:
            return f"{seconds / size:.0f}{unit}"
    return format_duration(seconds)
