"""What is learnt from requests, and what it predicts (rorg/core/prediction.py)."""

from __future__ import annotations

from dataclasses import replace

import pytest

from rorg.core.operations import Pause, Resume, Start
from rorg.core.plan import Action
from rorg.core.prediction import (
    DEPARTURES,
    FEWEST,
    LOOK,
    PASSING,
    REQUESTERS,
    STATES,
    Learning,
    Left,
    PredictionState,
    Stay,
    asked_for,
    observe,
    observe_requests,
    predict,
    with_begun,
    with_duration,
)
from rorg.model.catalog import Catalog, Group, Request, Service
from rorg.model.learned import Departure, Learned

NOW = 1000.0
CATALOG = Catalog(
    services={n: Service(n, needs=needs) for n, needs in (("tour", ("map",)), ("map", ()), ("ears", ()), ("dock", ()))},
    groups={"both": Group("both", ("tour", "ears"))},
)
WITHIN = {"tour": 5.0, "map": 3.0}


def knows(*departures: Departure, names: tuple[str, ...] = ("ears",), since: float | None = NOW) -> Learning:
    """A requester asks for `names` since then, and left that state before as these departures say."""
    return Learning(Learned({"tui": {names: departures}}), {"tui": Stay(names, since)})


def left(after: float, *to: str) -> Departure:
    return Departure(after, to)


def chance(learning: Learning, elapsed: float, name: str = "tour") -> float:
    found, _ = predict(learning, CATALOG, WITHIN, NOW + elapsed)
    return round(found[name].probability, 3) if name in found else 0.0


# -- predictions -----------------------------------------------------------------------------------------------


def test_the_chance_is_the_share_of_longer_stays_that_lead_there_in_time():
    learning = knows(*[left(10.0, "tour")] * 3, left(10.0, "dock"), left(60.0, "tour"))
    assert chance(learning, 4.9) == 0.0, "10 s are out of reach"
    assert chance(learning, 5.0) == round(3 / 6, 3)
    assert chance(learning, 9.9) == round(3 / 6, 3)
    assert chance(learning, 10.0) == 0.0, "those have passed; the last one is far"
    assert chance(learning, 56.0) == round(1 / 2, 3)
    assert predict(learning, CATALOG, WITHIN, NOW + 61.0) == ({}, None)


def test_what_is_needed_is_predicted_with_its_own_time():
    learning = knows(*[left(10.0, "tour")] * 5)
    assert chance(learning, 6.0, "map") == 0.0
    assert chance(learning, 7.0, "map") == round(5 / 6, 3)
    found, _ = predict(learning, CATALOG, WITHIN, NOW + 7.0)
    assert (found["map"].requester, found["map"].within) == ("tui", 3.0)


def test_the_next_look_is_when_a_departure_comes_within_reach_or_has_passed():
    learning = knows(*[left(10.0, "tour")] * 5)
    assert predict(learning, CATALOG, WITHIN, NOW)[1] == NOW + 5.0
    assert predict(learning, CATALOG, WITHIN, NOW + 5.0)[1] == NOW + 7.0
    assert predict(learning, CATALOG, WITHIN, NOW + 7.0)[1] == NOW + 10.0
    assert predict(learning, CATALOG, WITHIN, NOW + 9.5)[1] == NOW + 9.5 + LOOK
    assert predict(knows(*[left(10.0, "dock")] * 5), CATALOG, WITHIN, NOW) == ({}, None)


@pytest.mark.parametrize(("count", "predicts"), [(FEWEST - 1, False), (FEWEST, True)])
def test_a_few_departures_predict_nothing(count, predicts):
    assert bool(chance(knows(*[left(10.0, "tour")] * count), 6.0)) is predicts


def test_a_state_whose_beginning_is_not_known_predicts_nothing():
    assert chance(knows(*[left(10.0, "tour")] * 5, since=None), 6.0) == 0.0


def test_of_several_requesters_the_most_likely_one_counts():
    sure, unsure = [left(10.0, "tour")] * 9, [*[left(10.0, "tour")] * 5, *[left(10.0, "dock")] * 5]
    for first, second in ((sure, unsure), (unsure, sure)):
        learned = Learned({"one": {(): tuple(first)}, "two": {(): tuple(second)}})
        learning = Learning(learned, {"one": Stay((), NOW), "two": Stay((), NOW)})
        found, _ = predict(learning, CATALOG, WITHIN, NOW + 6.0)
        assert found["tour"].probability == 0.9
        assert found["tour"].requester == ("one" if first is sure else "two")


def test_what_a_group_asks_for_is_what_its_members_need():
    assert asked_for(CATALOG, ("both", "gone")) == {"tour", "map", "ears"}


# -- how long it takes -----------------------------------------------------------------------------------------


def test_a_duration_is_the_mean_with_the_one_before():
    learned = with_duration(Learned(), "tour", "start", 4.0, ["tour"])
    assert learned.took == {"tour": {"start": 4.0}}
    learned = with_duration(learned, "tour", "start", 2.0, ["tour"])
    learned = with_duration(learned, "tour", "resume", 0.12345, ["tour"])
    assert learned.took == {"tour": {"start": 3.0, "resume": 0.123}}
    assert with_duration(learned, "map", "start", 1.0, ["map"]).took == {"map": {"start": 1.0}}, "tour is gone"


def test_what_begins_is_timed_from_its_call():
    start, resume = Action(0, Start(container="1"), "tour"), Action(0, Resume(container="1"), "map")
    pause = Action(0, Pause(container="1"), "ears")
    learns = PredictionState(Learning(), begun={"dock": ("start", 1.0)})
    found = with_begun(learns, (start, resume, pause), NOW)
    assert found.begun == {"dock": ("start", 1.0), "tour": ("start", NOW), "map": ("resume", NOW)}
    assert with_begun(learns, (pause,), NOW) is learns
    off = PredictionState()
    assert with_begun(off, (start,), NOW) is off
    assert off.learned == Learned()
    assert learns.learned is learns.learning.learned


# -- learning --------------------------------------------------------------------------------------------------


def through(*states: tuple[float, tuple[str, ...]]) -> Learning:
    learning = observe(Learning(), 0.0, "tui", (), seen=True)
    for at, names in states:
        learning = observe(learning, at, "tui", names)
    return learning


def test_a_departure_is_known_when_the_state_after_it_has_lasted():
    learning = through((10.0, ("ears",)), (30.0, ("tour",)))
    assert learning.learned.of("tui", ()) == (Departure(10.0, ("ears",)),)
    assert learning.learned.of("tui", ("ears",)) == (), "it may be only a step"
    later = observe(learning, 40.0, "tui", ("dock",))
    assert later.learned.of("tui", ("ears",)) == (Departure(20.0, ("tour",)),)


def test_a_short_state_is_only_a_step_between_two_others():
    passed = through((10.0, ("ears",)), (10.0 + PASSING - 0.1, ("tour",)), (60.0, ()))
    assert passed.learned.of("tui", ()) == (Departure(10.0, ("tour",)),)
    assert passed.learned.of("tui", ("ears",)) == ()
    lasted = through((10.0, ("ears",)), (10.0 + PASSING, ("tour",)), (60.0, ()))
    assert lasted.learned.of("tui", ("ears",)) == (Departure(PASSING, ("tour",)),)
    back = through((10.0, ("ears",)), (10.5, ()), (30.0, ("tour",)), (60.0, ()))
    assert back.learned.of("tui", ()) == (Departure(30.0, ("tour",)),), "as if nothing had been between"


def test_a_state_that_was_found_and_not_seen_to_begin_teaches_nothing():
    found = observe(Learning(), 5.0, "tui", ("ears",))
    assert found.stays == {"tui": Stay(("ears",), None)}
    assert observe(found, 6.0, "tui", ("ears",)) is found
    later = observe(observe(found, 30.0, "tui", ("tour",)), 60.0, "tui", ())
    assert later.learned.of("tui", ("ears",)) == ()


def test_requests_of_manifests_are_no_habit():
    live = Request("a", "tui", ("tour", "ears")), Request("b", "tui", ("ears",)), Request("c", "gui", ("map",))
    standing = Request("d", "boot", ("map",), standing=True)
    found = observe_requests(Learning(), 1.0, (*live, standing), first=True)
    assert found.stays == {"tui": Stay(("ears", "tour"), None), "gui": Stay(("map",), None)}
    seen = observe_requests(Learning(), 1.0, live)
    assert seen.stays["tui"].since == 1.0
    gone = observe_requests(seen, 9.0, ())
    assert gone.stays["tui"] == Stay((), 9.0, Left(("ears", "tour"), 1.0, 9.0))


def test_old_habits_are_forgotten():
    learning = Learning()
    for number in range(REQUESTERS + 1):
        learning = observe(learning, 0.0, f"r{number}", ())
    assert len(learning.stays) == REQUESTERS
    assert "r0" not in learning.stays
    one, at = observe(Learning(), 0.0, "tui", (), seen=True), 0.0
    for number in range(DEPARTURES + 3):
        at += 10.0
        one = observe(observe(one, at, "tui", ("ears",)), at + 10.0 + number, "tui", ())
        at += 10.0 + number
    departures = one.learned.of("tui", ("ears",))
    assert len(departures) == DEPARTURES
    assert departures[-1].after > departures[0].after
    many, at = observe(Learning(), 0.0, "tui", (), seen=True), 0.0
    for number in range(STATES + 3):
        at += 10.0
        many = observe(many, at, "tui", (f"s{number}",))
    assert len(many.learned.departures["tui"]) == STATES
    assert () not in many.learned.departures["tui"]
    learned = replace(Learned(), departures={f"r{n}": {} for n in range(REQUESTERS)})
    more = Learning(learned, {"new": Stay(("x",), 5.0, Left((), 0.0, 5.0))})
    after = observe(more, 50.0, "new", ("y",)).learned.departures
    assert len(after) == REQUESTERS
    assert ("new" in after, "r0" in after) == (True, False)
