"""Services that change together or not at all (rorg/core/atomic.py)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from rorg.core.atomic import freed, judged_together, sets_of
from rorg.core.desired import desire
from rorg.core.digest import canonical, declared_fields
from rorg.core.memory import STALLED_AFTER, Attempt, Progress
from rorg.core.observed import Container, Observed
from rorg.core.update import Update
from rorg.model.catalog import Catalog, Service, Updating

SET = Updating(atomic="pair")
ARM, BASE = (Service(name, spec={"image": "2"}, update=SET) for name in ("arm", "base"))
DESIRED = desire(Catalog({"arm": ARM, "base": BASE, "alone": Service("alone", spec={"image": "2"})}))
WHY = "it did not come up"


def old(name: str, state: str = "running", image: str = "1", **more: Any) -> Container:
    spec = {"image": image}
    digest = DESIRED.digests[name] if image == "2" else "before"
    return Container(f"old-{name}", name, name, state, digest=digest, declared=canonical(declared_fields(spec)), **more)


def new(name: str, **more: Any) -> Container:
    """On trial, with the container before behind it."""
    return replace(old(name, image="2"), id=f"new-{name}", previous=f"old-{name}", **more)


def step(name: str, **more: Any) -> Progress:
    edition = DESIRED.editions[name]
    known = {
        "edition": edition,
        **{k: more.pop(k) for k in ("baked", "well", "quarantined", "drawn", "held") if k in more},
    }
    return replace(Progress(update=Update(**known)), **more)


def baked(name: str) -> Progress:
    return step(name, baked=DESIRED.editions[name], well=f"new-{name}")


def failed(name: str, **more: Any) -> Progress:
    return step(name, quarantined={DESIRED.editions[name]: WHY}, **more)


def judged(*seen: Container, wanted: tuple[str, ...] = ("arm", "base"), **known: Progress) -> dict[str, Progress]:
    progress = {"arm": step("arm"), "base": step("base"), **known}
    return judged_together(["pair"], progress, DESIRED, wanted, Observed(seen))


def told(found: dict[str, Progress]) -> dict[str, tuple[str, str, str]]:
    return {name: (p.update.held, p.update.proven, p.update.drawn) for name, p in found.items()}


def test_nobody_takes_its_place_before_all_are_made():
    assert told(judged(old("arm"), old("base"))) == {"arm": ("arm", "", ""), "base": ("arm", "", "")}
    waiting = judged(new("arm"), old("arm", "exited"), old("base"))
    assert told(waiting) == {"arm": ("base", "", ""), "base": ("base", "", "")}
    assert judged(new("arm"), old("arm", "exited"), new("base"), old("base", "exited")) == {}, "now all go on"


def test_what_is_not_wanted_waits_for_nobody_and_holds_up_nobody():
    assert told(judged(old("arm"), old("base"), wanted=("arm",))) == {"arm": ("arm", "", "")}
    one = judged(new("arm"), old("arm", "exited"), old("base", "exited"), wanted=("arm",), arm=baked("arm"))
    assert told(one) == {"arm": ("", "new-arm", "")}
    assert judged(old("arm"), old("base"), wanted=()) == {}


def test_nobody_is_proven_before_all_have_stayed_well():
    both = new("arm"), old("arm", "exited"), new("base"), old("base", "exited")
    assert judged(*both, arm=baked("arm")) == {}
    found = judged(*both, arm=baked("arm"), base=baked("base"))
    assert told(found) == {"arm": ("", "new-arm", ""), "base": ("", "new-base", "")}
    assert judged(*both, arm=step("arm", baked="another edition"), base=baked("base")) == {}


def test_if_one_fails_the_others_go_back():
    both = new("arm"), old("arm", "exited"), new("base"), old("base", "exited")
    tried = {"exits": 2, "attempts": {"start": Attempt(error="no")}, "error": "no"}
    found = judged(*both, arm=failed("arm"), base=replace(baked("base"), **tried))
    why = f"it changes together with arm, whose change failed: {WHY}"
    assert told(found) == {"base": ("", "", why)}
    assert (found["base"].exits, found["base"].attempts, found["base"].error) == (0, {}, ""), "without back-off"
    drawn = replace(found["base"], **tried)
    assert judged(*both, arm=failed("arm"), base=drawn) == {}, "it counts again since"
    assert told(judged(*both, arm=step("arm"), base=drawn)) == {"base": ("", "", "")}, "arm may be tried again"
    assert judged(*both, arm=failed("arm"), base=failed("base")) == {}


def test_nobody_is_held_or_proven_beside_a_failure():
    seen = old("arm"), new("base"), old("base", "exited")
    found = judged(*seen, arm=failed("arm", held="arm"), base=baked("base"))
    assert told(found)["arm"] == ("", "", "")
    assert told(found)["base"][:2] == ("", "")


@pytest.mark.parametrize(
    ("exits", "seen", "goes_back"),
    [
        (STALLED_AFTER - 1, (old("base"),), True),
        (STALLED_AFTER, (old("base"),), False),
        (STALLED_AFTER, (new("base"), old("base", "exited")), True),
    ],
)
def test_what_did_not_run_before_either_has_nothing_to_go_back_to(exits, seen, goes_back):
    found = judged(new("arm"), old("arm", "exited"), *seen, arm=failed("arm"), base=step("base", exits=exits))
    assert bool(found.get("base", Progress()).update.drawn) is goes_back


def test_what_matches_its_manifest_is_not_changing():
    as_it_is = replace(old("arm", image="2"), id="arm"), replace(old("base", image="2"), id="base")
    assert judged(*as_it_is) == {}
    assert judged(as_it_is[0]) == {}, "the other one has no container to go back to"
    assert told(judged(as_it_is[0], old("base"))) == {"base": ("base", "", "")}
    stopped = replace(as_it_is[0], state="exited")
    assert told(judged(old("arm"), stopped, old("base"))) == {"arm": ("base", "", ""), "base": ("base", "", "")}
    assert told(judged(old("arm", "exited"), stopped, old("base"))) == {"base": ("base", "", "")}, "arm is idle"


def test_a_change_that_was_taken_back_while_on_trial_is_a_change_too():
    """What runs is on trial for an edition that nobody wants any more; the container before matches again."""
    trial = replace(new("arm"), digest="another", declared=canonical(declared_fields({"image": "3"})))
    before = old("arm", "exited", image="2")
    assert told(judged(trial, before, old("base"))) == {"arm": ("base", "", ""), "base": ("base", "", "")}
    both = new("base"), old("base", "exited")
    assert judged(trial, before, *both, base=baked("base")) == {}, "it has not stayed well yet"


def test_a_set_is_known_by_its_members_and_left_without_a_trace():
    assert sets_of(["arm", "alone"], DESIRED) == {"pair"}
    assert sets_of(["alone"], DESIRED) == set()
    held, drawn = step("arm", held="base"), step("arm", drawn="base failed")
    assert freed(held, ARM, DESIRED) is held
    alone = Updating()
    for one in (held, drawn):
        assert freed(one, replace(ARM, update=alone), DESIRED).update == step("arm").update
    plain = step("arm")
    assert freed(plain, replace(ARM, update=alone), DESIRED) is plain


def test_a_change_that_failed_after_its_bake_proves_nobody():
    both = new("arm"), old("arm", "exited"), new("base"), old("base", "exited")
    late = failed("base", baked=DESIRED.editions["base"])
    assert told(judged(*both, arm=baked("arm"), base=late))["arm"][1] == ""
    assert "base" not in judged(*both, arm=baked("arm"), base=late)


def test_a_failure_concerns_only_who_changes():
    matches = replace(old("base", image="2"), id="base")
    assert judged(new("arm"), old("arm", "exited"), matches, arm=failed("arm")) == {}


def test_what_is_on_trial_but_not_wanted_is_proven_later():
    both = new("arm"), old("arm", "exited"), new("base"), old("base", "exited")
    found = judged(*both, wanted=("arm",), arm=baked("arm"), base=baked("base"))
    assert told(found) == {"arm": ("", "new-arm", "")}


def test_only_what_goes_back_begins_without_back_off():
    assert judged(old("arm"), old("base"), arm=step("arm", exits=2))["arm"].exits == 2
    both = new("arm"), old("arm", "exited"), new("base"), old("base", "exited")
    drawn = step("base", drawn=f"it changes together with arm, whose change failed: {WHY}", held="arm", exits=2)
    found = judged(*both, arm=failed("arm"), base=drawn)
    assert (found["base"].update.held, found["base"].exits) == ("", 2), "it went back before"


def test_what_is_on_trial_for_an_earlier_change_has_no_new_container():
    earlier = replace(new("arm"), digest="another", declared=canonical(declared_fields({"image": "3"})))
    assert told(judged(earlier, old("arm", "exited"), old("base")))["arm"] == ("arm", "", "")
    assert told(judged(old("arm", "exited"), old("base")))["arm"] == ("arm", "", ""), "nor has what is idle"
