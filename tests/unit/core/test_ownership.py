"""Which services a machine may start when its robot has several (rorg/core/ownership.py)."""

from __future__ import annotations

from rorg.core.links import Answer
from rorg.core.ownership import Owned, answered, others, replies, settled

HERE, BODY, ARM = "head", "body", "arm"
MACHINES = {HERE: 0, BODY: 7, ARM: 3}
"""With the number of the last renewal that was sent to each."""


def now(owned: Owned = Owned(), present: tuple[str, ...] = (), granted: tuple[str, ...] = (), **belongs: str) -> Owned:
    return settled(owned, belongs, HERE, present, MACHINES, granted)


def says(released: tuple[str, ...] = (), **kept: str) -> Answer:
    return Answer(1, (1, 1), released, kept)


ASKS = now(map=HERE)
"""`map` is to be taken over: both others are asked from their next renewal on."""


def test_a_service_is_taken_over_when_all_others_have_confirmed():
    assert (ASKS.owned, ASKS.asked) == (frozenset(), {"map": {BODY: 8, ARM: 4}})
    assert ASKS.waits("map", MACHINES, HERE) == "arm, where it may still run, has not answered"
    one = answered(ASKS, ARM, 4, says(("map",)))
    assert one.confirmed == {"map": {ARM}}
    assert now(one, map=HERE).owned == set()
    assert one.waits("map", MACHINES, HERE) == "body, where it may still run, has not answered"
    both = answered(one, BODY, 8, says(("map",)))
    assert both.waits("map", MACHINES, HERE) == "it is being taken over"
    taken = now(both, map=HERE)
    assert (taken.owned, taken.last, taken.asked, taken.confirmed) == ({"map"}, {"map": HERE}, {}, {})
    assert taken.waits("map", MACHINES, HERE) == ""


def test_an_answer_to_an_earlier_question_does_not_count():
    assert answered(ASKS, BODY, 7, says(("map",))) is ASKS
    assert answered(ASKS, "another", 99, says(("map",))) is ASKS
    assert answered(ASKS, BODY, 8, says(("nav",))) is ASKS, "nobody asked for that"


def test_why_a_machine_has_not_confirmed_is_told():
    found = answered(ASKS, BODY, 8, says(map="still has its container"))
    found = answered(found, ARM, 4, says(("map",)))
    assert found.waits("map", MACHINES, HERE) == "body, where it may still run, still has its container"
    assert now(found, map=HERE).kept == {"map": {BODY: "still has its container"}}
    assert now(found, map=BODY).kept == {}


def test_the_questions_stay_the_same_from_pass_to_pass():
    later = settled(ASKS, {"map": HERE}, HERE, (), {**MACHINES, BODY: 20, ARM: 20})
    assert later.asked == ASKS.asked


def test_a_person_may_confirm_instead():
    assert now(granted=("map",), map=HERE).owned == {"map"}
    assert now(granted=("map",), map=BODY).owned == set()


def test_what_runs_here_is_owned_until_it_has_gone():
    assert now(present=("map",), map=HERE).owned == {"map"}
    moved = now(Owned(frozenset({"map"}), {"map": HERE}), present=("map",), map=BODY)
    assert (moved.owned, moved.last) == ({"map"}, {"map": HERE}), "its container is still here"
    gone = now(moved, map=BODY)
    assert (gone.owned, gone.last) == (set(), {"map": BODY})
    stays = now(Owned(frozenset({"map"})), map=HERE)
    assert stays.owned == {"map"}, "though it has no container"


def test_the_last_owner_is_asked_even_if_the_robot_has_it_no_more():
    owned = Owned(last={"map": "old"})
    assert others(owned, "map", MACHINES, HERE) == [ARM, BODY, "old"]
    assert others(Owned(), "map", MACHINES, HERE) == [ARM, BODY]
    assert others(Owned(), "map", [HERE], HERE) == []
    alone = settled(Owned(), {"map": HERE}, HERE, (), {HERE: 0})
    assert alone.owned == {"map"}, "a robot of one machine"


def test_what_is_asked_for_is_released_unless_it_is_needed_here():
    owned = Owned(frozenset({"nav"}))
    belongs = {"map": BODY, "nav": BODY, "seen": BODY, "mine": HERE}
    takes = ("map", "nav", "seen", "mine", "unknown")
    assert replies(owned, belongs, HERE, ("seen",), takes) == (
        ("map", "unknown"),
        {
            "nav": "still has its container",
            "seen": "still has its container",
            "mine": "has manifests that give it to itself",
        },
    )
