"""Which removals wait for a person: what is still named stays as it was declared, and everything if a tree is empty."""

from __future__ import annotations

import pytest
from robots import write_tree

from rorg.core.desired import Desired, desire
from rorg.core.observed import Container, Observed
from rorg.core.withheld import EMPTIED, emptied, over, withhold
from rorg.manifest.load import load_or_raise
from rorg.model.catalog import Request
from rorg.model.former import Kept

ASKED = Request("drive", "developer", ("arm",))


@pytest.fixture
def tree(tmp_path):
    """Makes the desired state of a tree."""
    made = []

    def desired(services: dict, **kinds: dict) -> Desired:
        made.append(services)
        return desire(load_or_raise(write_tree(tmp_path / str(len(made)), services, **kinds)))

    return desired


def containers(*names: str, complete: bool = True) -> Observed:
    return Observed(tuple(Container(name, name, name, "running") for name in names), complete=complete)


def two_trees(first: Desired, second: Desired, observed: Observed, requests=(), confirmed=()):
    """What is withheld when the first tree becomes the second one."""
    kept, _, withheld = withhold(Kept(), first, requests, observed, ())
    assert withheld == {}
    return withhold(kept, second, requests, observed, confirmed)


def test_what_nothing_names_may_go(tree):
    _, desired, withheld = two_trees(tree({"base": {}, "arm": {}}), tree({"base": {}}), containers("base", "arm"))
    assert withheld == {}
    assert "arm" not in desired.catalog.services


def test_what_a_request_names_stays_as_it_was(tree):
    first, second = tree({"base": {}, "arm": {"priority": 70, "needs": ["base"]}}), tree({"base": {}})
    _, desired, withheld = two_trees(first, second, containers("base", "arm"), [ASKED])
    assert withheld == {"arm": "request 'drive' of developer names it"}
    assert desired.catalog.services["arm"].priority == 70
    assert desired.catalog.services["arm"].needs == ("base",)


def test_what_is_needed_or_in_a_group_stays(tree):
    first = tree(
        {"base": {}, "arm": {}, "tool": {"needs": ["arm"]}, "lamp": {}}, groups={"all": {"services": ["lamp"]}}
    )
    second = tree({"base": {}, "tool": {}})
    _, _, withheld = two_trees(first, second, containers("base", "arm", "tool", "lamp"))
    assert withheld == {"arm": "tool needed it", "lamp": "the group all named it"}


def test_services_that_only_needed_each_other_go_together(tree):
    first, second = tree({"base": {}, "arm": {}, "tool": {"needs": ["arm"]}}), tree({"base": {}})
    assert two_trees(first, second, containers("base", "arm", "tool"))[2] == {}
    asked = Request("drive", "developer", ("tool",))
    assert two_trees(first, second, containers("base", "arm", "tool"), [asked])[2] == {
        "arm": "tool needed it",
        "tool": "request 'drive' of developer names it",
    }


def test_a_confirmation_lets_it_go(tree):
    first, second = tree({"base": {}, "arm": {}}), tree({"base": {}})
    kept, desired, withheld = two_trees(first, second, containers("base", "arm"), [ASKED], ["arm"])
    assert withheld == {}
    assert "arm" not in desired.catalog.services
    assert over(["arm"], kept, desired.catalog, containers("base", "arm")) == ()
    kept, _, _ = withhold(kept, second, (), containers("base"), ["arm"])
    assert over(["arm"], kept, desired.catalog, containers("base")) == ("arm",)


def test_a_confirmation_is_over_when_what_it_names_is_declared_again(tree):
    first = tree({"base": {}, "arm": {}}, groups={"all": {"services": ["arm"]}})
    assert over(["arm", "all", "gone"], Kept(), first.catalog, containers("arm", "gone")) == ("arm", "all")
    assert over(["arm"], Kept(), first.catalog, containers("arm", complete=False)) == ()


def test_what_has_no_container_left_may_go(tree):
    first, second = tree({"base": {}, "arm": {}}), tree({"base": {}})
    assert two_trees(first, second, containers("base"), [ASKED])[2] == {}
    unknown = containers("base", complete=False)
    assert set(two_trees(first, second, unknown, [ASKED])[2]) == {"arm"}, "the engine has not said that it is gone"


def test_a_removal_that_is_withheld_stays_so_when_the_request_ends(tree):
    first, second = tree({"base": {}, "arm": {}}), tree({"base": {}})
    kept, _, _ = two_trees(first, second, containers("base", "arm"), [ASKED])
    again, desired, withheld = withhold(kept, second, (), containers("base", "arm"), ())
    assert set(withheld) == {"arm"}
    assert desired is kept.merged[2], "computed once"
    assert again.merged is kept.merged


def test_containers_of_unknown_trees_stay_while_a_request_names_them(tree):
    second, there = tree({"base": {}}), containers("base", "arm", "lamp")
    assert withhold(Kept(), second, [ASKED], there, ())[2] == {"arm": "request 'drive' of developer names it"}
    assert withhold(Kept(), second, [ASKED], there, ["arm"])[2] == {}


def test_a_policy_may_let_everything_go(tree):
    policy = {"policy": {"removals": "auto"}}
    first, second = tree({"base": {}, "arm": {}}, policies=policy), tree({"base": {}}, policies=policy)
    there = containers("base", "arm")
    assert two_trees(first, second, there, [ASKED])[2] == {}
    assert withhold(Kept(), second, [ASKED], there, ())[2] == {}


def test_an_emptied_tree_stops_nothing(tree):
    first, nothing = (
        tree({"base": {}, "arm": {"needs": ["base"]}}, groups={"all": {"services": ["arm"]}}),
        tree({}, policies={"policy": {}}),
    )
    assert emptied(nothing.catalog)
    assert not emptied(first.catalog)
    there = containers("base", "arm", "stranger")
    kept, desired, withheld = two_trees(first, nothing, there)
    assert withheld == dict.fromkeys(("base", "arm", "all", "stranger"), EMPTIED)
    assert desired.catalog.services["arm"].needs == ("base",)
    assert desired.catalog.groups["all"].services == ("arm",)
    assert withhold(kept, nothing, (), there, ())[2] == withheld, "until somebody confirms it"


def test_of_an_emptied_tree_what_is_confirmed_goes(tree):
    first, nothing = tree({"base": {}, "arm": {"needs": ["base"]}}), tree({}, policies={"policy": {}})
    kept, desired, withheld = two_trees(first, nothing, containers("base", "arm"), (), ["base"])
    assert set(withheld) == {"arm"}
    assert "base" not in desired.catalog.services
    assert desired.catalog.services["arm"].needs == ()
    kept, _, withheld = withhold(kept, nothing, (), containers("arm"), ["base", "arm"])
    assert withheld == {}
    assert over(["base", "arm"], kept, nothing.catalog, containers("arm")) == ("base",)


def test_a_group_stays_until_its_removal_is_confirmed(tree):
    first = tree({"base": {}, "arm": {}}, groups={"all": {"services": ["arm", "base"]}})
    second, asked = tree({"base": {}, "arm": {}}), [Request("drive", "developer", ("all",))]
    _, desired, withheld = two_trees(first, second, containers("base", "arm"), asked)
    assert withheld == {"all": "request 'drive' of developer names it"}
    assert desired.catalog.groups["all"].services == ("arm", "base")
    assert two_trees(first, second, containers("base", "arm"), asked, ["all"])[2] == {}
    assert two_trees(first, second, containers("base", "arm"))[2] == {}
