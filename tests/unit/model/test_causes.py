"""One root cause of many services is told once, with their names."""

from __future__ import annotations

from rorg.model.causes import causes

PARAGRAPH = "Error response: failed to create task: exec apparmor_parser: executable file not found in $PATH"


def refused(name: str, number: int) -> str:
    return f"start failed: cannot start {number:012x}: {PARAGRAPH}; try `journalctl -u docker`; again in {number} s"


def test_an_equal_cause_is_told_once_with_the_names():
    names = [f"s{i:02}" for i in range(20)]
    told = causes([*((n, refused(n, i)) for i, n in enumerate(names)), ("a", "waits for s00"), ("b", "waits for s00")])
    assert [str(cause) for cause in told] == [
        f"20 services (s00, s01, s02 and 17 more): start failed: cannot start them: {PARAGRAPH}; "
        "try `journalctl -u docker`",
        "2 services (a, b): waits for s00",
    ]


def test_failed_once_or_often_is_one_cause():
    told = causes(
        [("a", "start failed: no program x; again in 1 s"), ("b", "start stalled: no program x; again in 4 s")]
        + [("c", "start stalled: no program x; trying again now")]
    )
    assert [str(cause) for cause in told] == ["3 services (a, b, c): start failed: no program x"]


def test_a_cause_of_one_service_stays_as_it_is_and_others_stay_apart():
    assert [str(c) for c in causes([("a", refused("a", 7))])] == [f"a: {refused('a', 7)}"]
    told = causes([("a", "image a:latest not found"), ("b", "image b:latest not found")])
    assert [c.who for c in told] == ["a", "b"], "two images are two causes"
    assert (
        causes([("a", "start failed: cannot start x: no"), ("b", "create failed: cannot create y: no")])[1].who == "b"
    )
