"""The judge of the random soak finds what is wrong in events that are made up, and nothing in those that are right."""

from __future__ import annotations

from soak_random.judge import ACTED, Answer, Event, Hand, Rules, Span, acting, false_ready, overlaps, runs_of
from soak_random.revisions import Goal, Tried, history_faults, rollback_faults
from soak_random.witness import Witness

from rorg.core.observed import LABEL_SERVICE

RULES = Rules(
    frozenset((frozenset(("nav", "map")),)),
    {"cam": {"gpu": 1}, "net": {"gpu": 1}, "arm": {"bus": 1}, "head": {"bus": 1}, "base": {"bus": 1}},
    {"bus": 2},
)


def events(text: str) -> list[Event]:
    """Of lines such as "1.5 start nav"; a service has one container unless another is named."""
    found = []
    for line in text.strip().splitlines():
        at, action, service, *more = line.split()
        signal = more[0] if action == "kill" else ""
        container = more[0] if more and not signal else f"c-{service}"
        found.append(Event(float(at), action, container, service, signal=signal))
    return found


def found(text: str, *hands: Hand, away: tuple[Span, ...] = (), now: float = 1000.0) -> list[str]:
    return [fault.what for fault in overlaps(runs_of(events(text), hands), RULES, away, now)]


def test_an_overlap_of_two_in_conflict_is_found_with_its_length():
    assert found("1 start nav\n5 start map\n5.25 die nav") == ["nav conflicts with map for 0.250 s"]
    assert not found("1 start nav\n5 die nav\n5.001 start map")


def test_a_paused_service_does_not_run_and_a_resumed_one_does():
    assert not found("1 start nav\n2 pause nav\n3 start map")
    assert found("1 start nav\n2 pause nav\n3 start map\n4 unpause nav\n4.5 die nav") == [
        "map conflicts with nav for 0.500 s"
    ]


def test_a_paused_service_that_is_killed_only_ends():
    assert not found("1 start nav\n2 pause nav\n3 start map\n4 kill nav 9\n4.01 unpause nav\n4.02 die nav")
    assert found("1 start nav\n2 pause nav\n3 start map\n4 kill nav 15\n4.01 unpause nav\n4.02 die nav")


def test_more_users_than_units_are_found():
    assert not found("1 start arm\n2 start head")
    assert found("1 start arm\n2 start head\n3 start base\n4 die arm") == ["arm, head, base use bus for 1.000 s"]
    assert found("1 start cam\n2 start net\n2.5 die cam") == ["cam, net use gpu for 0.500 s"]


def test_two_containers_of_a_service_are_found():
    assert found("1 start nav one\n2 start nav two\n3 die nav one") == ["nav runs twice for 1.000 s"]


def test_what_a_hand_starts_is_excused_until_rorg_could_act():
    text = "1 start nav\n5 start map\n{} die map"
    hand = Hand(4.9, 5.1, "start", "c-map", "map")
    assert not found(text.format(8), hand)
    assert found(text.format(5 + ACTED + 1), hand)
    assert not found(text.format(5 + ACTED + 1), hand, away=(Span(6.0, 9.0),))
    assert found(text.format(8), Hand(4.9, 5.1, "stop", "c-map", "map")), "a stop starts nothing"


def test_rorg_starts_nothing_beside_what_a_hand_started_long_before():
    hand = Hand(0.9, 1.1, "start", "c-nav", "nav")
    assert not found("1 start nav\n1.5 start map\n3 die nav", hand)
    assert found("1 start nav\n4 start map\n5 die nav", hand)
    assert not found("1 start nav\n4 start map\n5 die nav", hand, away=(Span(0.5, 3.9),))


def test_an_engine_that_ends_resumes_what_is_paused_to_stop_it():
    text = "1 start nav\n2 pause nav\n3 start map\n4 unpause nav\n4.5 die map\n4.6 die nav"
    assert found(text)
    assert not found(text, Hand(3.9, 4.7, "unpause", "", ""))


def test_time_in_which_rorg_could_act():
    assert acting(0, 10, ()) == 10
    assert acting(0, 10, (Span(2, 4), Span(3, 5), Span(9))) == 6


def answer(text: str, at: float = 10.0, **more: object) -> list[str]:
    services = tuple(dict.fromkeys(line.split()[2] for line in text.strip().splitlines()))
    return [
        fault.what for fault in false_ready(Answer(at - 1, at, services, how="wait", **more), runs_of(events(text)))
    ]


def test_a_false_ready_is_found():
    assert not answer("1 start nav")
    assert "nav did not run" in answer("1 start nav\n5 die nav")[0]
    assert "nav did not run" in answer("1 start nav\n5 pause nav")[0]
    assert "nav did not run" in answer("11 start nav")[0]
    assert not answer("1 start nav\n9.9 die nav"), "nobody can know of it yet"


def test_another_version_is_found():
    run = runs_of([Event(1.0, "start", "c", "nav", 3)])
    right = Answer(9.0, 10.0, ("nav",), {"nav": frozenset((3, 4))})
    assert not false_ready(right, run)
    wrong = Answer(9.0, 10.0, ("nav",), {"nav": frozenset((4,))}, how="wait")
    assert "ran in edition [3] in place of [4]" in false_ready(wrong, run)[0].what
    assert not false_ready(Answer(9.0, 10.0, ("nav",), files={"nav": 0.5}), run)
    assert "before the file was written" in false_ready(Answer(9.0, 10.0, ("nav",), files={"nav": 2.0}), run)[0].what


def row(number: int, standing: str, proven_at: str = "", reason: str = "") -> dict:
    """A revision with a commit and content of its own."""
    more = {"commit": f"c{number}", "dirty": False, "fingerprint": f"f{number}"}
    return {"number": number, "standing": standing, "proven_at": proven_at, "reason": reason, **more}


def words(row: dict, known: Tried) -> str:
    return " ".join(fault.what for fault in history_faults([row], {1: known}, [], 0.0))


def test_a_false_word_of_the_history_is_found():
    crashing, fine = Tried(bad=frozenset(("nav",))), Tried(touched=frozenset(("arm",)))
    assert "cannot work" in words(row(1, "good", "today"), crashing)
    assert "cannot work" in words(row(1, "superseded", "today"), crashing)
    assert not words(row(1, "failed"), crashing)
    assert "nothing of it is bad" in words(row(1, "failed", reason="nav: ended"), fine)
    assert not words(row(1, "failed", reason="arm: ended"), fine)
    assert not words(row(2, "failed"), fine), "nothing is known of it"


def test_a_good_revision_of_what_never_ran_is_found():
    listed, tried = [row(2, "good", "today"), row(1, "good", "today")], {1: state(1), 2: state(2)}
    assert "nav never ran" in history_faults(listed, tried, [], 0.0)[0].what
    assert not history_faults(listed, tried, runs_of([Event(1.0, "start", "c", "nav", 2)]), 0.0)


def test_an_end_that_nobody_told_is_withdrawn_by_what_only_a_run_does():
    """Its removal tells nothing: what has ended is removed, too."""
    guess = Event(5.0, "die", "c-nav", "nav")
    for action, kept in (("destroy", True), ("start", True), ("die", False), ("pause", False), ("kill", False)):
        witness = Witness("unix:///nowhere")
        witness.add(guess)
        witness._guessed["c-nav"] = guess
        about = {LABEL_SERVICE: "nav"}
        witness._hear({"Actor": {"Attributes": about}, "Action": action, "id": "c-nav", "timeNano": 9_000_000_000})
        assert (guess in witness.known()) is kept, action


def state(nav: int, *, bad: bool = False, touched: bool = False) -> Tried:
    names = frozenset(("nav",))
    return Tried(names if bad else frozenset(), names if touched else frozenset(), {"nav": (nav, 0)})


def rollback(goal: Goal, tried: dict[int, Tried], *ran: int) -> str:
    """The fault of a rollback from the third of three revisions. Editions in `ran` of nav ran for long."""
    runs = runs_of(
        e
        for n in ran
        for e in (Event(100.0 * n, "start", f"{n}", "nav", n), Event(100.0 * n + 50, "die", f"{n}", "nav", n))
    )
    listed = [row(3, "failed"), row(2, "good", "today"), row(1, "good", "today")]
    return " ".join(fault.what for fault in rollback_faults(goal, listed, tried, runs, 0.0))


def test_a_rollback_to_what_was_not_proven_is_found():
    tried = {1: state(1), 2: state(2), 3: state(3, bad=True)}
    assert not rollback(Goal(2), tried, 1, 2)
    assert "nav never ran" in rollback(Goal(2), tried, 1)
    assert "nav cannot work" in rollback(Goal(2), {**tried, 2: state(2, bad=True)}, 1, 2)


def test_a_rollback_that_does_not_find_the_last_proven_one_is_found():
    tried = {1: state(1), 2: state(2), 3: state(3, bad=True)}
    assert "leads to revision 1, and revision 2 was proven" in rollback(Goal(1), tried, 1, 2)
    assert "is refused (nothing), and revision 2" in rollback(Goal(None, "nothing"), tried, 1, 2)
    assert not rollback(Goal(1), {**tried, 2: state(2, touched=True)}, 1, 2)
    assert not rollback(Goal(1), tried, 1), "the second one never ran"
    assert "without a reason" in rollback(Goal(None), tried, 1, 2)
