"""Every promise can be broken: each by the shortest log that does."""

from __future__ import annotations

from dataclasses import replace

import pytest
from proof import promises
from proof.engine_link import Entry
from proof.promises import STRANGER, Story

from rorg.core.observed import Container

OTHERS = Container(STRANGER, STRANGER, "", "running")
BASE = Container("b1", "base", "base", "running", started_at="1", digest="one")
NEXT = replace(BASE, id="b2", started_at="2", digest="two")
ARM = Container("a1", "arm", "arm", "running", started_at="1", digest="one")
SPECS = {
    "base": {"ready": {}, "exclusive": ["gpu"], "protected": True},
    "arm": {"needs": ["base"], "exclusive": ["gpu"]},
}


def entry(verb: str, target: Container | None, *there: Container, text: str = "") -> Entry:
    name, id = (target.service, target.id) if target else ("", "")
    return Entry(0.0, verb, name, id, text, {c.id: c for c in (OTHERS, *there)})


def told(verb: str) -> Entry:
    return Entry(0.0, verb, text="what was lost")


GIVEN = entry("given", None, BASE)
PROVEN = entry("exec", BASE, BASE, text="0")
CASES = {
    "acknowledged_requests_count": [told("lost")],
    "one_container_lives": [GIVEN, entry("start", NEXT, BASE, NEXT)],
    "nothing_is_made_twice": [GIVEN, entry("create", replace(BASE, id="b2"), BASE, replace(BASE, id="b2"))],
    "strangers_are_left_alone": [Entry(0.0, "stop", "", STRANGER, "", {STRANGER: replace(OTHERS, state="exited")})],
    "needs_are_ready_first": [GIVEN, entry("start", ARM, BASE, ARM)],
    "exclusive_is_exclusive": [GIVEN, PROVEN, entry("start", ARM, BASE, ARM)],
    "the_good_one_stays_until_the_next_is_proven": [
        GIVEN,
        PROVEN,
        entry("start", NEXT, BASE, NEXT),
        entry("remove", BASE, NEXT),
    ],
    "images_are_built_once": [Entry(0.0, "build_image", "", "cam:1", "again")],
    "protected_services_are_not_shed": [entry("stop", BASE)],
    "files_are_whole": [told("half")],
    "it_converges": [told("late")],
}
COMPARED = ("it_ends_as_without_a_crash", "nothing_is_tried_more_often")
"""Promises about the same run without a crash."""
SOUND = [GIVEN, PROVEN, entry("create", NEXT, BASE, replace(NEXT, state="created"))]
SOUND += [
    entry("start", NEXT, replace(BASE, state="exited", exit_code=0), NEXT),
    entry("exec", NEXT, replace(BASE, state="exited"), NEXT, text="0"),
]
SOUND += [entry("remove", BASE, NEXT)]


def test_a_paused_run_that_is_stopped_runs():
    paused, arm = replace(BASE, state="paused"), replace(ARM, service="arm")
    story = [entry("given", None, paused, arm), entry("stop", paused, replace(BASE, state="exited"), arm)]
    specs = {"base": {}, "arm": {"conflicts": ["base"]}}
    assert list(promises.exclusive_is_exclusive(Story(story, specs)))
    alone = [entry("given", None, paused), entry("stop", paused, replace(BASE, state="exited"))]
    assert not list(promises.exclusive_is_exclusive(Story(alone, specs)))


@pytest.mark.parametrize("name", CASES)
def test_a_promise_can_be_broken(name):
    assert list(getattr(promises, name)(Story(CASES[name], SPECS)))


def test_the_end_can_differ():
    calm = Story([], SPECS, end={"containers": []})
    assert list(promises.it_ends_as_without_a_crash(Story([], SPECS, end={"containers": [1]}, reference=calm)))
    assert list(promises.nothing_is_tried_more_often(Story(SOUND, SPECS, reference=calm)))
    assert list(promises.it_converges(Story([GIVEN, PROVEN, *[GIVEN] * 20], SPECS, reference=calm)))


def test_a_proper_replacement_breaks_none():
    assert promises.violations(Story(SOUND, SPECS)) == []
    assert {promise.__name__ for promise in promises.PROMISES} == {*CASES, *COMPARED}
