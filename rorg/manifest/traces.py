"""Files of a trace: a document of kind Trace. It is no part of a tree; commands that simulate are given one."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Annotated

from pydantic import Field, model_validator

from rorg.manifest.fields import Written, field
from rorg.manifest.one_document import OneDocument, read_document
from rorg.manifest.option_forms import Strict
from rorg.manifest.scalars import Duration, Name
from rorg.model.diagnostics import Diagnostic, nearest
from rorg.model.trace import Trace, TraceEvent

Services = Annotated[list[Name], Field(min_length=1)]


class TraceEntry(Strict):
    """Something that happens at a time. Exactly one of state, request, release."""

    at: Duration = field("When, since the trace began. No earlier than the entry before.", "12.5s", ...)
    state: str | None = field("A state that the behaviour enters: one of `states`.", "tour")
    request: Name | None = field("The id of a request that is made, or made anew.", "look")
    release: Name | None = field("The id of a request that is given up.", "look")
    services: Services | None = field("What is requested: services and groups.", ["usb_cam"])
    by: Name | None = field(
        "Who requests, or whose behaviour it is.", "behavioral", unset="developer; of a state the trace's `behaviour`"
    )

    @model_validator(mode="after")
    def _one(self) -> TraceEntry:
        if sum(v is not None for v in (self.state, self.request, self.release)) != 1:
            raise ValueError("exactly one of state, request, release must be given")
        if (self.request is None) != (self.services is None):
            raise ValueError("request and services belong together")
        return self


class TraceSpec(Strict):
    """What a robot is asked for over some time."""

    duration: Duration = field("How long it lasts.", "4h", ...)
    behaviour: Name = field("The service whose states these are.", "behavioral", "developer")
    states: Annotated[dict[str, list[Name]], Written("mapping of lists of names")] = field(
        "What the behaviour requests in each of its states.", {"tour": ["navigation"], "charging": []}, dict
    )
    events: list[TraceEntry] = field("What happens, in order of time.", [{"at": "5s", "state": "tour"}], ...)


def read_trace(path: Path, known: Collection[str] | None = None) -> Trace:
    """The trace in a file. `known`: services and groups of the robot that it is for; None leaves names unchecked.
    Raises Invalid with all that is wrong with it, each with file:line:column."""
    return read_document(path, "Trace", TraceSpec, lambda found: _trace(found, known))


def _trace(found: OneDocument[TraceSpec], known: Collection[str] | None) -> tuple[Trace, list[Diagnostic]]:
    diagnostics = [] if known is None else list(_unknown(found, known))
    spec, events, before = found.spec, list[TraceEvent](), 0.0
    held: set[tuple[str, str]] = set()
    for index, entry in enumerate(spec.events):
        where = found.document.where
        if entry.at < before:
            what = f"it comes after an entry of {before:g} s"
            diagnostics.append(Diagnostic(where(("spec", "events", index, "at")), what, "ordering entries by time"))
        if entry.at > spec.duration:
            what = f"after the end of the trace, {spec.duration:g} s"
            diagnostics.append(Diagnostic(where(("spec", "events", index, "at")), what, "a longer duration"))
        before = max(before, entry.at)
        if entry.state is not None and entry.state not in spec.states:
            what, remedy = f"unknown state '{entry.state}'", nearest(entry.state, spec.states)
            diagnostics.append(Diagnostic(where(("spec", "events", index, "state")), what, remedy))
        event = _event(spec, entry)
        if entry.release is not None and (event.requester, event.id) not in held:
            what = f"{event.requester} holds no request '{event.id}' then"
            diagnostics.append(Diagnostic(where(("spec", "events", index, "release")), what))
        (held.add if event.services else held.discard)((event.requester, event.id))
        events.append(event)
    return Trace(found.name, spec.duration, tuple(events), found.description), diagnostics


def _event(spec: TraceSpec, entry: TraceEntry) -> TraceEvent:
    if entry.state is not None:
        who = entry.by or spec.behaviour
        return TraceEvent(entry.at, who, who, tuple(spec.states.get(entry.state, ())), entry.state)
    who = entry.by or "developer"
    return TraceEvent(entry.at, who, entry.request or entry.release or "", tuple(entry.services or ()))


def _unknown(found: OneDocument[TraceSpec], known: Collection[str]) -> Iterator[Diagnostic]:
    """Names that the robot does not have, at every place."""
    spec, names = found.spec, {*known, "developer"}
    places = list[tuple[str, tuple[str | int, ...]]]([(spec.behaviour, ("behaviour",))])
    for state, services in spec.states.items():
        places += [(name, ("states", state, index)) for index, name in enumerate(services)]
    for index, entry in enumerate(spec.events):
        places += [(name, ("events", index, "services", i)) for i, name in enumerate(entry.services or ())]
        places += [(entry.by, ("events", index, "by"))] if entry.by else []
    for name, path in places:
        if name not in names:
            what = f"no service or group '{name}'"
            yield Diagnostic(found.document.where(("spec", *path)), what, nearest(name, names))
