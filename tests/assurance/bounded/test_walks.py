"""Random walks keep every promise: some in each run, WALKS of them by `make worlds WALKS=20000 ARGS='-k walks'`."""

from __future__ import annotations

import os

import pytest
from bounded.invariants import INVARIANTS, Invariant
from bounded.steps import DO
from bounded.walk_steps import DOES, WEIGHTS
from bounded.walk_worlds import JOINS, MORE_SINGLE, world_of
from bounded.walks import CASES, REST, Tally, Walk, broken, draw, load, save, shrink
from bounded.worlds import TRIPLE

WALKS = int(os.environ.get("RORG_TEST_WALKS") or 20)
OFTEN = 500
"""Walks after which a long run says how far it is."""


@pytest.fixture
def seed(request: pytest.FixtureRequest) -> str:
    """The same for the few walks of each run, so that everyone's run is the same; a long run draws one, unless
    RORG_TEST_WALKS_SEED names it."""
    drawn = str(request.config.getoption("hypothesis_seed")) if "RORG_TEST_WALKS" in os.environ else "287"
    return os.environ.get("RORG_TEST_WALKS_SEED") or drawn


@pytest.mark.slow
def test_random_walks_keep_every_promise(seed, capsys):
    tally = Tally()

    def say(line: str) -> None:
        with capsys.disabled():
            print(line, flush=True)

    for number in range(WALKS):
        walk = draw(seed, number)
        found = broken(walk, tally)
        if found is not None:
            small = shrink(walk, found.name)
            again = broken(small, Tally()) or found
            pytest.fail(f"RORG_TEST_WALKS_SEED={seed}, walk {number}: {again}\n{small}\n{save(small, again)}")
        if number % OFTEN == OFTEN - 1:
            say(f"walks: {tally}")
    say(f"walks: RORG_TEST_WALKS_SEED={seed}: {tally}")


@pytest.mark.parametrize("case", sorted(CASES.glob("*.json")), ids=lambda path: path.stem)
def test_a_walk_that_failed_once_does_not_again(case):
    assert (found := broken(load(case), Tally())) is None, str(found)


def test_a_walk_is_drawn_again_from_its_seed():
    assert draw(1, 2) == draw(1, 2) != draw(1, 3)
    one, other = Tally(), Tally()
    assert str(broken(draw(1, 2), one)) == str(broken(draw(1, 2), other))
    assert (one.steps, one.passes) == (other.steps, other.passes)


@pytest.mark.parametrize("feature", [*MORE_SINGLE, *JOINS, *TRIPLE, "needs", "restart", "conflict", "gpu", "set"])
def test_rorg_accepts_each_feature(feature):
    """A world that it refuses is never walked."""
    of = ("0",) if feature in MORE_SINGLE else ("2", "1", "0") if feature in TRIPLE else ("1", "0")
    needs = [("needs", "1", "0")] if feature in ("restart", *JOINS) else []
    world = world_of(3, (*needs, (feature, *of)))
    assert world.trees.load(world.trees.first()) is not None


def test_each_verb_can_be_walked():
    assert WEIGHTS.keys() <= {*DO, *DOES}


def test_a_broken_promise_shrinks_to_the_steps_that_break_it(monkeypatch):
    def holds(watch):
        assert "s1" not in watch.robot.active(), "s1 runs"

    monkeypatch.setitem(INVARIANTS, "s1 never runs", Invariant("rest", holds))
    steps = ((("twice",), 0.1), (("request", 1), 0.6), (("back",), REST), (("crash", 0), 0.0))
    walk = Walk(3, (("needs", "1", "0"), ("high", "0")), steps)
    small = shrink(walk, broken(walk, Tally()).name)
    assert [step for step, _ in small.steps] == [("request", 1)]
    assert (small.services, small.features) == (2, ())
