"""Traces that are written to a file: read back, they are the same."""

from __future__ import annotations

import pytest
from common import ROOT
from hypothesis import given
from hypothesis import strategies as st

from rorg.manifest.traces import read_trace, trace_text
from rorg.model.trace import Trace, TraceEvent
from rorg.model.units import LONGEST, NAME

NAMES = st.from_regex(NAME, fullmatch=True).map(str.strip) | st.sampled_from(["1", "yes", "null", "1e3", "0.5", "10s"])
SERVICES = st.lists(NAMES, max_size=4).map(tuple)
TIMES = st.floats(0, LONGEST) | st.integers(0, 90_000).map(float)


@st.composite
def traces(draw):
    """States, requests and releases of what is held."""
    states = draw(st.dictionaries(NAMES, SERVICES, max_size=3))
    held, events = set(), []
    for at in sorted(draw(st.lists(TIMES, max_size=8))):
        kind = draw(st.sampled_from(["request", *(["state"] if states else []), *(["release"] if held else [])]))
        if kind == "state":
            who, state = draw(NAMES), draw(st.sampled_from(sorted(states)))
            events.append(TraceEvent(at, who, who, states[state], state))
        elif kind == "request":
            events.append(TraceEvent(at, draw(NAMES), draw(NAMES), draw(SERVICES.filter(bool))))
        else:
            events.append(TraceEvent(at, *draw(st.sampled_from(sorted(held)))))
        last = events[-1]
        (held.add if last.services else held.discard)((last.requester, last.id))
    duration = max([draw(TIMES), *(event.at for event in events)])
    return Trace(draw(NAMES), duration, tuple(events), draw(st.text(st.characters(exclude_categories=["C"]))))


@pytest.mark.slow
@given(traces())
def test_what_is_written_is_read_back(tmp_path_factory, trace):
    path = tmp_path_factory.getbasetemp() / "trace.yaml"
    path.write_text(trace_text(trace))
    assert read_trace(path) == trace


def test_events_stand_in_a_line_each_and_services_of_states_once():
    navigating = ("navigation", "laser")
    events = (
        TraceEvent(0.0, "developer", "look", ("camera",)),
        TraceEvent(12.5, "guide", "guide", navigating, "tour"),
        TraceEvent(30.0, "guide", "guide", (), "charging"),
        TraceEvent(40.0, "guide", "guide", navigating, "tour"),
        TraceEvent(60.0, "developer", "look"),
        TraceEvent(61.0, "visitor", "ask", ("speech",)),
    )
    assert (
        trace_text(Trace("morning", 7200.0, events, "Two tours."))
        == """\
apiVersion: rorg/v1
kind: Trace
metadata:
  name: morning
  description: Two tours.
spec:
  duration: 2h
  behaviour: guide
  states:
    tour: [navigation, laser]
    charging: []
  events:
    - {at: 0s, request: look, services: [camera]}
    - {at: 12.5s, state: tour}
    - {at: 30s, state: charging}
    - {at: 40s, state: tour}
    - {at: 60s, release: look}
    - {at: 61s, request: ask, services: [speech], by: visitor}
"""
    )


def test_a_state_with_two_meanings_is_no_file():
    events = (TraceEvent(0.0, "a", "a", ("x",), "go"), TraceEvent(1.0, "a", "a", ("y",), "go"))
    with pytest.raises(ValueError, match="state 'go'"):
        trace_text(Trace("t", 2.0, events))


def test_the_traces_of_the_evaluation_are_written_this_way():
    for path in (ROOT / "docs/evaluation").glob("*.yaml"):
        if "kind: Trace\n" in path.read_text():
            assert trace_text(read_trace(path)) == path.read_text()
