"""What a service gets from its profiles: one or several, built in or of its tree; each value tells its source."""

from __future__ import annotations

import pytest
from built_in_profiles import BUILT_IN, GIVES
from robots import write_tree

from rorg.core.desired import desire
from rorg.manifest.effective import Value, effective
from rorg.manifest.load import load, load_or_raise

FORMER = ("fb9d033e39103561", "v1:7b266b54c999d106fa3ca587a0d785ff")


def loaded(folder, *profile: str, **profiles: dict):
    """Two services of the same profiles: one names them, one has a profile that extends them."""
    specs = {
        "roscore": {"command": "roscore", "always_on": True},
        "named": {"profile": list(profile), "container": {"container_name": "arm"}},
        "extended": {"profile": "together", "container": {"container_name": "arm2"}},
    }
    both = {**profiles, "together": {"extends": list(profile)}}
    return load_or_raise(write_tree(folder, specs, profiles=both)).services


def source_of(found: list[Value], field: str) -> str:
    """Where a value comes from, without the line."""
    return next(v.source for v in found if v.field == field).rpartition(":")[0]


@pytest.mark.parametrize(
    "profile",
    [
        ("ros1", "realtime"),
        ("realtime", "ros1"),
        ("ros2", "gpu", "x11"),
        ("plain", "ros1"),
        ("ros1", "plain"),
        ("mine", "x11"),
        ("ros1", "ros1"),
    ],
)
def test_a_list_is_a_profile_that_extends_them_in_order(tmp_path, profile):
    mine = {"extends": ["ros1"], "idle": {"action": "pause"}, "container": {"environment": {"DISPLAY": ":7"}}}
    services = loaded(tmp_path, *profile, mine=mine)
    named, extended = services["named"], services["extended"]
    told = {"container_name", "environment"}
    assert {k: v for k, v in named.spec.items() if k not in told} == {
        k: v for k, v in extended.spec.items() if k not in told
    }
    variables = [{**s.spec.get("environment", {}), "RORG_SERVICE": ""} for s in (named, extended)]
    assert variables[0] == variables[1]
    assert (named.needs, named.restarts_with, named.idle) == (extended.needs, extended.restarts_with, extended.idle)


def test_later_ones_win_over_earlier_ones(tmp_path):
    first = {"ready": {"tcp": 1}, "idle": {"linger": "5s"}, "container": {"environment": {"LEVEL": "a", "ONE": "1"}}}
    second = {"ready": {"tcp": 2}, "container": {"environment": {"LEVEL": "b"}, "cap_add": ["SYS_NICE"]}}
    found = loaded(tmp_path, "first", "second", first=first, second=second)["named"]
    assert str(found.ready) == "tcp 127.0.0.1:2"
    assert found.idle.linger == 5.0
    assert {"LEVEL": "b", "ONE": "1"}.items() <= found.spec["environment"].items()
    values = effective(tmp_path, "named")
    assert source_of(values, "ready.tcp") == "profile second, profiles/second.yaml".replace(
        "profiles/", f"{tmp_path}/profiles/"
    )
    assert source_of(values, "container.environment.ONE").startswith("profile first, ")
    assert source_of(values, "container.environment.LEVEL").startswith("profile second, ")
    assert source_of(values, "container.init").startswith("profile common, <built in>")


def test_one_name_is_what_it_was(tmp_path):
    """By the digest and the fingerprint of before there were lists."""
    spec = {"image": "img", "command": "roslaunch nav", "profile": "realtime"}
    catalog = load_or_raise(write_tree(tmp_path, {"nav": spec}))
    assert (catalog.fingerprint, desire(catalog).digests["nav"]) == FORMER
    alone = load_or_raise(write_tree(tmp_path, {"nav": {**spec, "profile": ["realtime"]}}))
    assert alone.fingerprint == catalog.fingerprint
    write_tree(tmp_path, {"nav": spec})
    assert next(v.value for v in effective(tmp_path, "nav") if v.field == "profile") == "realtime"


def test_what_several_need_is_needed_and_told_once(tmp_path):
    profiles = {"a1": {"extends": ["ros1"]}, "b1": {"extends": ["ros1"]}}
    found = loaded(tmp_path, "a1", "b1", **profiles)["named"]
    assert found.needs == ("roscore",)
    assert [v.value for v in effective(tmp_path, "named") if v.field.startswith("needs")] == [
        {"service": "roscore", "restart": True}
    ]
    assert next(v.value for v in effective(tmp_path, "named") if v.field == "profile") == ["a1", "b1"]


def test_an_unknown_one_is_told_at_its_place(tmp_path):
    tree = write_tree(tmp_path, {"nav": {"profile": ["realtime", "ros_1"]}, "none": {"profile": []}})
    told = [(d.where.line, d.message, d.remedy) for d in load(tree).errors]
    lines = (tree / "services/nav.yaml").read_text().splitlines()
    assert (lines.index("  - ros_1") + 1, "unknown profile 'ros_1'", "'ros1'") in told
    assert any("at least 1 item" in message for _, message, _ in told)


# -- the built-in ones ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("profile", [*BUILT_IN, "common"])
def test_a_profile_of_the_same_name_replaces_it(tmp_path, profile):
    own = {"container": {"environment": {"OURS": "1"}, "cap_drop": ["ALL"]}}
    named = profile if profile != "common" else "ros2"
    tree = write_tree(tmp_path, {"nav": {"image": "img", "profile": named}}, profiles={profile: own})
    values = {v.field: v for v in effective(tree, "nav")}
    assert source_of([*values.values()], "container.environment.OURS").startswith(f"profile {profile}, {tmp_path}")
    assert values["container.cap_drop[0]"].value == "ALL"
    if GIVES.get(profile):
        assert GIVES[profile][0] not in values
    if profile == "common":
        assert "container.init" not in values


@pytest.mark.parametrize("profile", BUILT_IN)
def test_a_profile_that_extends_it_adds_to_it(tmp_path, profile):
    mine = {"extends": [profile], "container": {"environment": {"OURS": "1"}}}
    specs = {"nav": {"image": "img", "profile": "mine"}, "roscore": {"image": "img", "command": "roscore"}}
    tree = write_tree(tmp_path, specs, profiles={"mine": mine})
    values = effective(tree, "nav")
    assert source_of(values, "container.environment.OURS").startswith("profile mine, ")
    if GIVES[profile]:
        field, value = GIVES[profile]
        assert next(v.value for v in values if v.field == field) == value
        assert source_of(values, field) == f"profile {profile}, <built in>/{profile}.yaml"
