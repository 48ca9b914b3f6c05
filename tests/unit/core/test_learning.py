"""What follows what is learnt from requests."""

from __future__ import annotations

from rorg.core.prediction import DEPARTURES, Learning, learn, observe, observe_requests
from rorg.model.catalog import Request
from rorg.model.learned import Departure
from rorg.model.trace import TraceEvent


def states(*pairs: tuple[float, tuple[str, ...]]) -> list[TraceEvent]:
    return [TraceEvent(at, "guide", "guide", services) for at, services in pairs]


def test_what_follows_what_and_when():
    found = learn(states((0, ("ears",)), (60, ("ears", "voice")), (75, ("ears",)), (100, ("wheels",)), (400, ())))
    assert found.of("guide", ("ears",)) == (Departure(60, ("ears", "voice")), Departure(25, ("wheels",)))
    assert found.of("guide", ("ears", "voice")) == (Departure(15, ("ears",)),)
    assert found.of("guide", ("wheels",)) == (Departure(300, ()),)


def test_requests_of_one_requester_count_together():
    events = [
        TraceEvent(0, "guide", "a", ("ears",)),
        TraceEvent(10, "guide", "b", ("voice",)),
        TraceEvent(30, "guide", "a"),
        TraceEvent(50, "guide", "b"),
    ]
    found = learn(events)
    assert found.of("guide", ("ears",)) == (Departure(10, ("ears", "voice")),)
    assert found.of("guide", ("ears", "voice")) == (Departure(20, ("voice",)),)


def test_a_brief_state_is_a_step_on_the_way():
    found = learn(states((0, ("ears",)), (60, ()), (60.5, ("wheels",)), (90, ("ears",)), (100, ()), (100.5, ("ears",))))
    assert found.of("guide", ("ears",)) == (Departure(60, ("wheels",)),)
    assert found.of("guide", ("wheels",)) == (Departure(29.5, ("ears",)),)


def test_what_is_kept_is_bounded_and_the_latest():
    events = states(*((float(n * 10), ("ears",) if n % 2 else ("wheels",)) for n in range(2 * DEPARTURES + 100)))
    assert len(learn(events).of("guide", ("ears",))) == DEPARTURES
    many = states(*((float(n * 10), (f"s{n}",)) for n in range(300)))
    assert len(learn(many).departures["guide"]) == 64


def test_what_was_asked_for_before_anybody_watched_tells_no_time():
    asked = Request("r", "guide", ("ears",))
    learning = observe_requests(Learning(), 1000.0, [asked], first=True)
    learning = observe_requests(learning, 1005.0, [Request("r", "guide", ("wheels",))])
    learning = observe_requests(learning, 1045.0, [])
    learning = observe(learning, 1100.0, "guide", ("ears",))
    assert learning.learned.of("guide", ("ears",)) == ()
    assert learning.learned.of("guide", ("wheels",)) == (Departure(40.0, ()),)


def test_standing_requests_teach_nothing():
    learning = observe_requests(Learning(), 0.0, [Request("r", "guide", ("ears",), standing=True)])
    assert not learning.stays
