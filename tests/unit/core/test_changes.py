"""What changed between two passes: by mapping, by version, by sequence."""

from __future__ import annotations

import pytest

from rorg.core.changes import KEPT, SLICE, Version, changed_items, changed_keys, differing, updated

A, B, C, D = ([n] for n in range(4))
"""Values that are told apart by identity."""


def test_changes_are_found_by_identity():
    before = {"a": A, "b": B}
    assert changed_keys(before, before) == changed_keys(before, {**before}) == set()
    assert changed_keys(before, {"a": A, "b": [1]}) == {"b"}
    assert changed_keys(before, {"b": B, "a": A}) == set()
    assert changed_keys(before, {"a": A, "b": C, "c": C}) == {"b", "c"}
    assert changed_keys(before, {"a": C}) == {"a"}
    assert differing(before, {"a": A, "b": [1]}) == set()
    assert differing(before, {"a": C, "c": C}) == {"a", "b", "c"}
    assert differing({"a": A, "b": B}, {"a": A}) == differing({"a": A}, {"a": A, "b": B}) == {"b"}


def test_a_version_knows_what_changed_since_each_of_the_versions_before():
    first = updated({"a": A, "b": B}, {"c": C})
    second = updated(first, {"a": D}, gone=("b",))
    third = updated(updated(second, {"a": A}), {"b": C, "d": D})
    assert (first, second, third) == (
        {"a": A, "b": B, "c": C},
        {"a": D, "c": C},
        {"a": A, "b": C, "c": C, "d": D},
    )
    assert changed_keys(first, second) == {"a"}, "what is gone is not in it"
    assert changed_keys(first, third) == {"b", "d"}, "a is what it was"
    assert changed_keys(second, third) == {"a", "b", "d"}
    assert changed_keys(third, first) == {"b"}, "backwards, all are compared"
    assert changed_keys(updated(first, {"a": D}), updated(first, {"c": A})) == {"a", "c"}, "two branches, too"


class Unread(Version):
    """A version that nobody may go through as a whole."""

    def __iter__(self):
        raise AssertionError("all of it is read")


def test_what_changed_since_a_version_is_known_without_reading_all_of_it():
    first = Unread({"a": A, "b": B})
    first.steps, first.mark = (), object()
    last = updated(first, {"c": C})
    for _ in range(KEPT - 1):
        assert changed_keys(first, last) == {"c"}
        last = updated(last, {"c": last["c"]})
    assert changed_keys(first, last) == {"c"}
    with pytest.raises(AssertionError, match="is read"):
        changed_keys(first, updated(last, {}))


def test_a_version_remembers_a_bounded_number_of_steps():
    first = last = updated({}, {"a": A})
    for number in range(3 * KEPT):
        last = updated(last, {"b": number})
    assert isinstance(last, Version)
    assert len(last.steps) == KEPT
    assert changed_keys(first, last) == {"b"}


@pytest.mark.parametrize("place", [0, SLICE - 1, SLICE, 3 * SLICE])
def test_one_of_many_items_is_found(place):
    before = tuple(object() for _ in range(3 * SLICE + 1))
    now = (*before[:place], A, *before[place + 1 :])
    assert changed_items(before, now) == ([before[place]], [A])


def test_items_that_only_one_side_has_are_found():
    assert changed_items([A, B], [A, B]) == ([], [])
    assert changed_items([A, B], [A, C]) == ([B], [C])
    assert changed_items([A, B], [A, B, C]) == ([], [C])
    assert changed_items([A, B, C], [A, B]) == ([C], [])
    assert changed_items([A, B, C], [B, C]) == ([A], [])
    assert changed_items([B, C], [A, B, C, D]) == ([], [A, D])
