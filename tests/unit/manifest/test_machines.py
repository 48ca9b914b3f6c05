"""Kind Machine in manifests: what a tree of several computers must say, and what cannot cross them."""

from __future__ import annotations

from pathlib import Path

import pytest
from robots import write_tree

from rorg.core.peers import seen_from
from rorg.manifest.load import load
from rorg.manifest.machines import machine_for
from rorg.model.diagnostics import Diagnostic

BASE, HEAD = {"address": "nora-base.local", "default": True}, {"address": "10.0.0.2:7000", "lease": "20s"}


def errors(folder: Path, services: dict, machines: dict | None = None, **kinds: dict) -> list[str]:
    tree = write_tree(folder / "tree", services, machines=machines or {"base": BASE, "head": HEAD}, **kinds)
    return [d.message for d in load(tree).errors]


def test_services_belong_to_the_machine_that_they_name_or_to_the_default(tmp_path):
    tree = write_tree(
        tmp_path, {"aa": {}, "bb": {"machine": "head"}, "m": {"type": "meta"}}, machines={"base": BASE, "head": HEAD}
    )
    catalog = load(tree).catalog
    assert catalog is not None
    assert {n: s.machine for n, s in catalog.services.items()} == {"aa": "base", "bb": "head", "m": "", "developer": ""}
    assert catalog.machines["base"].address == "nora-base.local:7878"
    assert (catalog.machines["head"].lease, catalog.machines["head"].certificate) == (20.0, "machine-head")
    here = seen_from(catalog, "base")
    assert [n for n, s in here.services.items() if s.away] == ["bb"]
    assert here.services["bb"].spec is None
    assert here.services["aa"] is catalog.services["aa"]


@pytest.mark.parametrize(
    ("services", "told"),
    [
        ({"a": {"machine": "haed"}}, "unknown machine 'haed'"),
        ({"a": {"needs": ["b"]}, "b": {"machine": "head", "needs": ["a"]}}, "services need each other: a -> b -> a"),
        ({"a": {"conflicts": ["b"]}, "b": {"machine": "head"}}, "'a' conflicts with 'b', which runs on head"),
        (
            {"a": {"needs": ["b"], "container": {"network_mode": "service:b"}}, "b": {"machine": "head"}},
            "'a' is joined to the container of 'b', which runs on head",
        ),
        (
            {"a": {"update": {"atomic": "set"}}, "b": {"machine": "head", "update": {"atomic": "set"}}},
            "'b' changes together with 'a', which runs on base",
        ),
    ],
)
def test_what_cannot_cross_machines_is_an_error_of_the_whole_tree(tmp_path, services, told):
    """Rule 9: cycles are checked over the joint graph, and `validate` sees all machines."""
    assert told in errors(tmp_path, services)


@pytest.mark.parametrize(
    ("machines", "told"),
    [
        ({"base": {"address": "x"}}, "'a' does not say on which machine it runs"),
        ({"base": BASE, "head": {**HEAD, "default": True}}, "the machine 'base' is the default, too"),
        ({"base": BASE, "head": {"address": "nora-base.local:7878"}}, "the machine 'base' has the same address"),
        (
            {"base": BASE, "head": {**HEAD, "certificate": "machine-base"}},
            "the machine 'base' has the same certificate",
        ),
    ],
)
def test_a_mistake_in_a_machine_is_an_error(tmp_path, machines, told):
    assert told in errors(tmp_path, {"a": {}}, machines)


@pytest.mark.parametrize("lease", ["9.9s", "31s", "0s"])
def test_leases_last_10_to_30_seconds(tmp_path, lease):
    """Rule 10."""
    assert errors(tmp_path, {"a": {}}, {"base": {**BASE, "lease": lease}})


def test_a_tree_without_machines_has_the_fingerprint_that_it_had(tmp_path):
    """A new version of rorg changes nothing by itself."""
    before = load(write_tree(tmp_path / "one", {"aa": {}})).catalog
    after = load(write_tree(tmp_path / "two", {"aa": {}}, machines={"base": BASE})).catalog
    assert before is not None
    assert after is not None
    assert before.fingerprint != after.fingerprint
    assert before.services["aa"].spec == after.services["aa"].spec


def test_a_computer_finds_out_which_machine_it_is(tmp_path):
    catalog = load(write_tree(tmp_path, {"aa": {}}, machines={"base": BASE, "head": HEAD})).catalog
    assert catalog is not None
    assert machine_for(catalog.machines, "head", "somewhere") == "head"
    assert machine_for(catalog.machines, "", "base.local") == "base"
    assert machine_for({}, "head", "somewhere") == ""
    for named, host in (("haed", "base"), ("", "somewhere")):
        told = machine_for(catalog.machines, named, host)
        assert isinstance(told, Diagnostic)
        assert "base, head" in told.message


ANY = {"base": BASE, "any": {"address": "lab"}}


def test_what_may_run_anywhere_is_rendered_for_the_swarm(tmp_path):
    """No node has the tree, and none has rorg to restart what ended."""
    (tmp_path / "services/planner.d").mkdir(parents=True)
    (tmp_path / "services/planner.d/a.yaml").write_text("a: 1")
    planner = {
        "machine": "any",
        "placement": ["node.role == worker"],
        "resources": {"cpu": 0.5},
        "mounts": ["./planner.d:/etc/planner"],
        "restart": "on-failure",
    }
    loaded = load(write_tree(tmp_path, {"planner": planner}, machines=ANY))
    assert [str(e) for e in loaded.errors] == []
    spec = loaded.catalog.services["planner"].spec
    source = str(tmp_path / "services/planner.d")
    assert spec["volumes"] == [{"type": "tree", "source": source, "target": "/etc/planner", "read_only": True}]
    assert (spec["placement"], spec["reserve"], spec["restart"]) == (
        ["node.role == worker"],
        {"cpu": 0.5},
        "on-failure",
    )


@pytest.mark.parametrize(
    ("services", "machines", "told"),
    [
        ({"a": {"machine": "any"}}, {"base": BASE}, "no Machine is called 'any', whose rorg has the Swarm"),
        ({"a": {"placement": ["node.role==worker"]}}, ANY, "'a' belongs to one machine, so nothing places it"),
        ({"a": {"machine": "any", "idle": {"action": "pause"}}}, ANY, "and a Swarm has no pause"),
        ({"a": {"machine": "any", "driver": True}}, ANY, "and a Swarm has no driver of hardware"),
        ({"a": {"machine": "any", "on_change": "signal HUP"}}, ANY, "and a Swarm has no signal (SIGHUP)"),
        ({"a": {"machine": "any", "may_request": ["a"]}}, ANY, "and a Swarm has no socket of rorg, which may_request"),
        ({"a": {"machine": "any", "ready": {"exec": ["true"]}}}, ANY, "and a Swarm has no `exec` in a container"),
        ({"a": {"machine": "any", "container": {"cpuset": "0"}}}, ANY, "and a Swarm has no cpuset"),
        ({"a": {"machine": "any", "exclusive": ["gpu"]}}, ANY, "'a' is to be the only user of gpu"),
    ],
)
def test_what_a_swarm_cannot_do_is_an_error(tmp_path, services, machines, told):
    assert any(told in message for message in errors(tmp_path, services, machines))


@pytest.mark.parametrize(
    ("named", "engine", "right"),
    [("any", "swarm", True), ("base", "docker", True), ("any", "docker", False), ("base", "swarm", False)],
)
def test_the_machine_any_and_no_other_has_a_swarm(tmp_path, named, engine, right):
    machines = load(write_tree(tmp_path, {"aa": {}}, machines=ANY)).catalog.machines
    assert (machine_for(machines, named, "", engine) == named) is right
