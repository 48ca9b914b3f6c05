"""How changed fields read: one line each, the difference in sight, and a unified diff of a whole container."""

from __future__ import annotations

import pytest
from robots import write_tree

from rorg.core.changed_fields import Change, changes_between, field_changes, manifest_changes, unified
from rorg.core.desired import desire
from rorg.core.digest import canonical, declared_fields
from rorg.core.observed import Container
from rorg.manifest.load import load_or_raise

LONG_OLD, LONG_NEW = "a" * 50 + "b" + "c" * 80, "a" * 50 + "x" + "c" * 80


@pytest.mark.parametrize(
    ("field", "old", "new", "text"),
    [
        ("cpus", 1.0, 2.0, "cpus: 1.0 -> 2.0"),
        ("hostname", None, "arm", "hostname: (unset) -> arm"),
        ("hostname", "", "arm", 'hostname: "" -> arm'),
        ("volumes", ["a:/a", "b:/b"], ["b:/b", "c:/c"], "volumes: + c:/c, - a:/a"),
        ("volumes", ["a:/a", "b:/b"], ["b:/b", "a:/a"], "volumes: order changed"),
        ("volumes", None, ["c:/c"], "volumes: + c:/c"),
        ("volumes", ["c:/c"], None, "volumes: - c:/c"),
        ("command", ["sleep", "1 2"], ["sleep", "3"], "command: sleep '1 2' -> sleep 3"),
        ("ports", [1], [2], "ports: + 2, - 1"),
        ("ports", [1, "a"], "b", 'ports: [1, "a"] -> b'),
        ("tmpfs", ["/run"], "/run/lock", "tmpfs: /run -> /run/lock"),
        ("mem_limit", 1 << 30, 2 << 30, "mem_limit: 1.0Gi -> 2.0Gi"),
        ("memswap_limit", -1, 0, "memswap_limit: -1 -> 0"),
        ("environment.TOKEN", None, "***", "environment.TOKEN added"),
        ("environment.TOKEN", "***", None, "environment.TOKEN removed"),
        ("environment.TOKEN", "***", "x", "environment.TOKEN changed"),
        ("environment.TOKEN", "***", "***", "environment.TOKEN changed"),
        ("command", "a" * 60, "b", f"command: {'a' * 60} -> b"),
        ("command", "a" * 61, "b", f"command: {'a' * 60}... -> b"),
        (
            "command",
            LONG_OLD,
            LONG_NEW,
            f"command: ...{'a' * 16}b{'c' * 43}... -> ...{'a' * 16}x{'c' * 43}...",
        ),
        ("command", f"aaaa{'b' * 70}", f"aaaa{'c' * 10}", f"command: aaaa{'b' * 56}... -> aaaa{'c' * 10}"),
    ],
)
def test_a_change_reads_as_one_line(field, old, new, text):
    change = Change(field, old, new)
    assert str(change) == text
    assert change.as_json() == {"field": field, "old": old, "new": new, "text": text}


def test_mappings_change_by_key():
    assert field_changes("labels", {"a": "1", "b": "2"}, {"a": "1", "b": "3", "c": "4"}) == [
        Change("labels.b", "2", "3"),
        Change("labels.c", None, "4"),
    ]
    assert field_changes("labels", None, {"a": "1"}) == [Change("labels.a", None, "1")]
    assert field_changes("labels", {"a": "1"}, None) == [Change("labels.a", "1", None)]
    assert field_changes("labels", None, {}) == [Change("labels", None, {})]
    assert field_changes("sysctls", {"a": {"b": 1}}, {"a": {"b": 2}}) == [Change("sysctls.a.b", 1, 2)]
    assert changes_between({"image": "a", "labels": {"b": "1"}}, {"image": "a", "labels": {"b": "2"}}) == (
        Change("labels.b", "1", "2"),
    )


def container_of(spec: dict, **live: object) -> Container:
    return Container("0123456789abcdef", "arm", "arm", "running", declared=canonical(declared_fields(spec)), live=live)


def test_a_unified_diff_shows_what_differs_as_yaml():
    was = {"image": "arm:1", "command": ["run", "2"], "environment": {"MODE": "fast"}, "volumes": ["/a:/a", "/b:/b"]}
    now = {**was, "image": "arm:2", "volumes": ["/b:/b", "/a:/a"], "cpus": 2.0}
    assert unified("arm", container_of(was), now).splitlines() == [
        "--- arm (container 0123456789ab)",
        "+++ arm (manifests)",
        "@@ -1,8 +1,9 @@",
        " command:",
        "   - run",
        '   - "2"',
        "+cpus: 2.0",
        ' environment.MODE: "***"',
        '-image: "arm:1"',
        '+image: "arm:2"',
        " volumes:",
        '   - "/b:/b"',
        '   - "/a:/a"',
    ]
    assert unified("arm", container_of(was), was) == ""


def test_a_unified_diff_shows_mappings_by_key():
    labels = {"image": "arm", "labels": {"team": "arms", "c": "No", "b": "_x-y/z", "a": "1.5"}}
    assert unified("arm", None, labels).splitlines()[3:] == [
        "+image: arm",
        "+labels:",
        '+  a: "1.5"',
        "+  b: _x-y/z",
        '+  c: "No"',
        "+  team: arms",
    ]


def test_what_is_masked_on_both_sides_is_marked():
    was, now = ({"image": "arm", "environment": {"MODE": mode}} for mode in ("fast", "slow"))
    assert [line for line in unified("arm", container_of(was), now).splitlines() if "#" in line] == [
        "-  # before",
        "+  # after",
    ]


def test_a_side_that_is_missing_is_empty():
    assert unified("arm", None, {"image": "arm"}).splitlines() == [
        "--- arm (no container)",
        "+++ arm (manifests)",
        "@@ -0,0 +1 @@",
        "+image: arm",
    ]
    assert unified("arm", container_of({"image": "arm"}), None).splitlines()[-1] == "-image: arm"


def test_live_options_count_as_they_were_set_since():
    was = {"image": "arm", "cpus": 1.0}
    assert unified("arm", container_of(was, cpus=2.0), {"image": "arm", "cpus": 2.0}) == ""
    assert unified("arm", container_of(was, cpus=None), was) == ""


def test_changes_of_manifests_name_each_resource_once(tmp_path):
    def tree(name: str, specs: dict, **kinds: dict):
        catalog = load_or_raise(write_tree(tmp_path / name, specs, **kinds))
        return desire(catalog, contents={"arm": {"/maps": name, f"/{name}": "1"}})

    old = tree(
        "old", {"arm": {"priority": 50}, "gone": {}, "tour": {"type": "meta"}}, groups={"all": {"services": ["arm"]}}
    )
    new = tree(
        "new", {"arm": {"priority": 60}, "came": {}, "tour": {"type": "meta"}}, groups={"all": {"services": ["arm"]}}
    )
    found = {(c.kind, c.name): (c.verb, [str(change) for change in c.changes]) for c in manifest_changes(old, new)}
    assert found == {
        ("Service", "arm"): ("change", ["/maps changed", "/new added", "/old removed", "priority: 50 -> 60"]),
        ("Service", "came"): ("add", []),
        ("Service", "gone"): ("remove", []),
    }
    assert manifest_changes(old, old) == ()
    assert [c.as_json()["verb"] for c in manifest_changes(new, old)] == ["change", "remove", "add"]
