"""All small worlds within a bound keep every promise: a slice of them here, all by `make worlds` (see bounds.py)."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys

import pytest
from bounded.bounds import slice_of, whole
from bounded.cases import CASES, load, save, shrink
from bounded.explore import REST, Bound, Explorer, Tally, replay
from bounded.invariants import INVARIANTS, Invariant
from bounded.worlds import World, specs_of, worlds
from common import ASSURANCE, ROOT, SUPPORT

WHOLE = os.environ.get("RORG_TEST_WORLDS") == "all"
SEED = 1
"""Of the slice: the same in every run, because a test that may fail by chance holds up other people's work."""
NEED = World(specs_of((("needs", "1", "0"),), 2), "needs")


@pytest.mark.slow
def test_the_worlds_within_the_bound_keep_every_promise(capsys):
    def say(line: str) -> None:
        with capsys.disabled():
            print(line, flush=True)

    tally = whole(say) if WHOLE else slice_of(SEED, Tally())
    say(f"worlds: {tally}")
    assert not tally.found, f"{save(shrink(tally.found[0]))}: {tally.found[0]}"


@pytest.mark.parametrize("case", sorted(CASES.glob("*.json")), ids=lambda path: path.stem)
def test_a_world_that_failed_once_does_not_again(case):
    world, path = load(case)
    assert (found := replay(world, path)) is None, str(found)


def test_worlds_that_differ_in_names_only_come_once():
    """Acyclic graphs without labels: 1, 2, 6, 31 (OEIS A003087)."""
    assert [len(list(worlds(n, 0))) for n in (1, 2, 3, 4)] == [1, 2, 6, 31]


def test_each_invariant_says_what_it_promises():
    assert len(INVARIANTS) > 30
    assert {i.moment for i in INVARIANTS.values()} == {"begin", "call", "pass", "rest"}
    assert all(invariant.holds.__doc__ for invariant in INVARIANTS.values())


@pytest.mark.parametrize("call", ["fail", "did", "late", "lost", "hang"])
@pytest.mark.parametrize("event", ["skip", "stale", "twice", "reborn", "outage"])
def test_what_is_asked_for_is_ready_after_the_last_fault(event, call):
    """A call that lies, and events that are lost, late or doubled, while two services come up: then no fault."""
    of = (0,) if event == "skip" else ()
    path = (((call, 0), 0.0), ((call, 1), 0.0), (("request", 1), 0.05), ((event, *of), REST))
    assert (found := replay(NEED, path)) is None, str(found)


def decisions() -> str:
    """Digest of all decisions in a part of the slice."""
    tally = Tally(decisions=hashlib.sha256())
    for world in [*worlds(2, 1)][:3]:
        Explorer(world, Bound(2, 1, 2, True, (0.05,)), tally, sample=4, seed=SEED).run()
    return f"{tally.passes} {tally.decisions.hexdigest()}"


@pytest.mark.slow
def test_a_seeded_run_repeats_bit_for_bit():
    program = "from bounded.test_bounded_worlds import decisions; print(decisions())"
    paths = os.pathsep.join(map(str, (ASSURANCE, SUPPORT, ROOT, ROOT / "clients/python")))
    said = {
        subprocess.run(
            [sys.executable, "-c", program],
            env={**os.environ, "PYTHONPATH": paths, "PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("1", "2")
    }
    assert len(said) == 1
    assert int(said.pop().split()[0]) > 100


def test_a_failing_case_shrinks_to_a_file_that_fails_alike(monkeypatch, tmp_path):
    def holds(watch):
        assert "s0" not in watch.robot.active(), "s0 runs"

    monkeypatch.setitem(INVARIANTS, "nothing ever runs", Invariant("rest", holds))
    path = ((("request", 1), REST), (("reborn",), 0.05), (("change", 0), REST))
    found = shrink(replay(NEED, path))
    assert found.path == ((("request", 1), REST),)
    assert found.world.specs["s1"] == {"needs": ["s0"]}
    again = replay(*load(save(found, tmp_path)))
    assert again.violation.name == "nothing ever runs"
