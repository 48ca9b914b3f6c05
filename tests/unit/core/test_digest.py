"""What a container's labels record, and how it differs from what is declared (rorg/core/digest.py and diff.py)."""

from __future__ import annotations

import json
from typing import Any

import pytest

from rorg.core.diff import Difference, declared_anew, declared_now, difference, normal, normal_fields
from rorg.core.digest import (
    Rules,
    canonical,
    declared_fields,
    declared_of,
    digest,
    labels,
    marked,
    rules_of,
    same,
    unreadable,
)
from rorg.core.observed import LABEL_DECLARED, LABEL_RULES, LABEL_SERVICE, Container
from rorg.model.catalog import Spec
from rorg.model.probe import Probe

SPEC: Spec = {"image": "x", "command": "run", "environment": {"KEY": "swordfish"}, "mem_limit": 100}
LOCK = Probe("tcp", "base:80", interval=0.5)


def container(spec: Spec, **more: Any) -> Container:
    return Container("a", "a", "base", "exited", digest=digest(spec), declared=canonical(declared_fields(spec)), **more)


# -- labels ----------------------------------------------------------------------------------------------------


def test_the_labels_say_only_what_there_is_to_say():
    plain = labels("robot", "base", {"image": "x", "labels": {"team": "arm"}}, "v1:0", Rules())
    assert plain == {
        "team": "arm",
        "rorg.io/owner": "robot",
        "rorg.io/service": "base",
        "rorg.io/spec": "v1:0",
        "rorg.io/declared": '{"image":"x","labels":{"team":"arm"}}',
    }
    more = {"previous": "b", "joined": {"core": "c"}, "devices": '{"d":"1"}'}
    assert {k: v for k, v in labels("robot", "base", {"image": "x"}, "v1:0", Rules(), **more).items()} == {
        **{k: v for k, v in plain.items() if k not in ("team", LABEL_DECLARED)},
        LABEL_DECLARED: '{"image":"x"}',
        "rorg.io/previous": "b",
        "rorg.io/joined": '{"core":"c"}',
        "rorg.io/devices": '{"d":"1"}',
    }


@pytest.mark.parametrize(
    "rules",
    [Rules(LOCK), Rules(exclusive={"gpu": 2}), Rules(conflicts=("drive",)), Rules(LOCK, {"gpu": 1}, ("a", "b"))],
)
def test_rules_are_read_as_they_were_written(rules):
    written = labels("robot", "base", {}, "", rules)[LABEL_RULES]
    assert rules_of(written) == rules


@pytest.mark.parametrize(("written", "read"), [(0.01, 0.05), (0.05, 0.05), (3600.0, 3600.0), (9999.0, 3600.0)])
def test_an_interlock_of_a_label_is_asked_at_a_sane_interval(written, read):
    label = json.dumps({"interlock": ["http", "http://x", written], "exclusive": {}, "conflicts": []})
    assert rules_of(label) == Rules(Probe("http", "http://x", interval=read))


@pytest.mark.parametrize(
    "label",
    [
        "",
        "{",
        "[]",
        "{}",
        '{"interlock": ["exec", "rm", 1], "exclusive": {"gpu": 1}, "conflicts": []}',
        '{"interlock": ["tcp"], "exclusive": {}, "conflicts": []}',
        '{"interlock": null, "exclusive": {"gpu": "many"}, "conflicts": []}',
        '{"interlock": null, "exclusive": {"gpu": 1e999}, "conflicts": []}',
    ],
)
def test_rules_that_cannot_be_read_hold_nothing_back(label):
    assert rules_of(label) == Rules()
    assert bool(unreadable(Container("a", "a", "base", "exited", rules=label))) == bool(label)


def test_what_is_wrong_with_labels_is_said_with_its_consequence():
    good = container(SPEC, rules=labels("robot", "base", {}, "", Rules(LOCK))[LABEL_RULES])
    assert unreadable(good) == unreadable(Container("a", "a", "base", "exited")) == ""
    bad = unreadable(Container("a", "a", "base", "exited", declared="{"))
    assert bad == f"its label {LABEL_DECLARED} cannot be read: the container is replaced if its digest differs"
    nobody = unreadable(Container("a", "a", "", "exited"))
    assert nobody == f"its label {LABEL_SERVICE} names no service: it is left alone"
    assert unreadable(Container("a", "a", "", "exited", error="odd")) == "odd: it is left alone"
    assert declared_of("[]") == {}


# -- secrets in labels -----------------------------------------------------------------------------------------


MARK = "***(b9f195c5cc7e)"
"""Of `swordfish`."""


def test_a_secret_is_marked_wherever_it_is_declared():
    assert marked("command", "run swordfish", ["swordfish"]) == f"run {MARK}"
    assert marked("command", ["a", "swordfish"], ["swordfish"]) == ["a", MARK]
    assert marked("labels", {"a": "swordfish", "b": 7}, ["swordfish"]) == {"a": MARK, "b": 7}
    assert marked("command", "run sworn", ["sworn"]) == "run sworn", "it is too short"
    assert marked("image", "swordfish", ["swordfish"]) == "swordfish", "rorg reads it back"
    assert marked("command", "swordfish1", ["swordfish", "swordfish1"]) != f"{MARK}1", "the longer one comes first"
    assert declared_fields({**SPEC, "command": "run swordfish"}, ["KEY"]) == {
        "image": "x",
        "command": f"run {MARK}",
        "mem_limit": 100,
        "environment.KEY": "sha256:b9f195c5cc7e",
    }


@pytest.mark.parametrize(
    ("a", "b", "equal"),
    [
        ("run", "run", True),
        ("run", "ran", False),
        (f"run {MARK} now", "run swordfish now", True),
        (f"run {MARK} now", "run swordfish", False),
        (f"run {MARK} now", "run another now", False),
        (f"run {MARK} now", "go swordfish now", False),
        (f"{MARK}x{MARK}", "swordfishxswordfish", False),
        (f"aa{MARK}aa", "aa", False),
        ({"a": MARK}, {"a": "swordfish"}, True),
        ({"a": MARK}, {"a": "other"}, False),
        ({"a": 1}, {"a": 1, "b": 2}, False),
        ({"a": 1}, "a", False),
        ("a", {"a": 1}, False),
        ([MARK, 1], ["swordfish", 1], True),
        ([MARK], ["swordfish", 1], False),
        ([1, 2], [1, 3], False),
        ([], "", False),
        ([MARK], {"a": "swordfish"}, False),
        (1, 1, True),
        (1, 2, False),
    ],
)
def test_a_mark_equals_the_secret_that_it_stands_for(a, b, equal):
    assert same(a, b) is same(b, a) is equal


# -- differences -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("now", "recreate"),
    [
        (SPEC, ()),
        ({**SPEC, "command": "go"}, ("command",)),
        ({**SPEC, "environment": {"KEY": "other"}}, ("environment.KEY",)),
        ({**SPEC, "environment": {}}, ("environment.KEY",)),
        ({**SPEC, "hostname": "a", "command": "go"}, ("command", "hostname")),
        ({k: v for k, v in SPEC.items() if k != "command"}, ("command",)),
        ({**SPEC, "security_opt": []}, ()),
        ({**SPEC, "container_name": "other"}, ()),
        ({k: v for k, v in SPEC.items() if k != "mem_limit"}, ("mem_limit",)),
        ({**SPEC, "mem_limit": 0}, ("mem_limit",)),
        ({**SPEC, "cpu_shares": 5}, ("cpu_shares",)),
    ],
)
def test_options_that_need_a_new_container(now, recreate):
    assert difference(container(SPEC), now, digest(now), declared_now(now)) == Difference(recreate)


@pytest.mark.parametrize(
    ("present", "now", "live"),
    [
        ({"mem_limit": 100}, {}, {}),
        ({"mem_limit": 50}, {}, {"mem_limit": 100}),
        ({"mem_limit": 100}, {"mem_limit": 200}, {"mem_limit": 200}),
        ({"mem_limit": None}, {}, {}),
        ({"mem_limit": None}, {"mem_limit": 200}, {"mem_limit": 200}),
        ({}, {"mem_limit": 200}, {}),
        ({"mem_limit": 100, "cpu_shares": 0}, {}, {}),
        ({"mem_limit": 100, "cpu_shares": 0}, {"mem_limit": 200, "cpu_shares": 5}, {"mem_limit": 200}),
        ({"mem_limit": 100, "pids_limit": -1}, {"mem_limit": 200}, {"mem_limit": 200}),
    ],
)
def test_options_that_the_engine_changes_in_place(present, now, live):
    spec = {**SPEC, **now}
    assert difference(container(SPEC, live=present), spec, digest(spec), declared_now(spec)).live == live


def test_without_a_readable_record_only_a_new_container_is_right():
    blank = Container("a", "a", "base", "exited", digest="v1:0", live={"mem_limit": 50})
    assert difference(blank, SPEC, digest(SPEC), declared_now(SPEC)) == Difference(("digest",))
    same_digest = Container("a", "a", "base", "exited", digest=digest(SPEC), live={"mem_limit": 50})
    assert difference(same_digest, SPEC, digest(SPEC), declared_now(SPEC)) == Difference(live={"mem_limit": 100})


def test_a_value_that_was_declared_when_the_container_was_made_is_not_declared_anew():
    now = declared_now({**SPEC, "mem_limit": 200, "cpu_shares": 5})
    assert declared_anew(container(SPEC), ["mem_limit", "cpu_shares", "command"], now) == ("cpu_shares", "mem_limit")


@pytest.mark.parametrize(
    ("option", "value", "form"),
    [
        ("command", None, None),
        ("security_opt", ["no-new-privileges:true", "label:disable"], ["label=disable", "no-new-privileges"]),
        ("security_opt", ["seccomp=a:b"], ["seccomp=a:b"]),
        ("security_opt", ["apparmor"], ["apparmor"]),
        ("cap_add", ["CAP_SYS_ADMIN", "sys_admin", "kill"], ["KILL", "SYS_ADMIN"]),
        ("pids_limit", 0, None),
        ("pids_limit", -1, None),
        ("pids_limit", 1, 1),
        ("restart", "no", None),
        ("restart", "on-failure:0", "on-failure"),
        ("stop_signal", "15", "SIGTERM"),
        ("stop_signal", "SIGINT", "SIGINT"),
        ("masked_paths", [], []),
        ("masked_paths", ["/b", "/a", "/b"], ["/a", "/b"]),
        ("devices", ["/dev/a:/dev/b:wr"], ["/dev/a:/dev/b:rw"]),
        ("devices", [7], [7]),
        ("expose", ["81", "80-81"], ["80/tcp", "81/tcp"]),
        ("extra_hosts", ["b:1", "a:2", "a:1"], ["a:2", "a:1", "b:1"]),
        ("extra_hosts", [], None),
        ("healthcheck", {"disable": True, "test": ["CMD", "x"]}, {"disable": True}),
        ("healthcheck", {"test": ["NONE"]}, {"disable": True}),
        ("healthcheck", {"test": ["CMD", "x"], "retries": 0, "interval": None}, {"test": ["CMD", "x"]}),
        ("healthcheck", {"retries": 0}, None),
        ("networks", {"a": {"aliases": ["y", "x"], "ipv4_address": ""}}, {"a": {"aliases": ["x", "y"]}}),
        ("networks", {}, None),
        ("network_mode", "bridge", None),
        ("network_mode", "host", "host"),
        ("volumes", ["/a/:/b/:rw", "maps:/m:ro,nocopy"], ["/a:/b", "maps:/m:nocopy,ro"]),
        ("volumes", [{"type": "volume", "source": "a", "read_only": False}], [{"type": "volume", "source": "a"}]),
        ("tmpfs", ["/a/", "/b:size=1,mode=2"], ["/a", "/b:mode=2,size=1"]),
        ("command", "", None),
        ("environment.KEY", "", ""),
    ],
)
def test_values_that_make_the_same_container_have_one_form(option, value, form):
    assert normal(option, value) == form
    assert normal_fields({option: value}) == ({} if form is None else {option: form})
