"""Services that use the network, the shared memory, the processes or the volumes of another service's container."""

from __future__ import annotations

import os
from dataclasses import replace

import pytest
from robots import VirtualRobot, write_tree

from rorg.core.desired import desire
from rorg.core.joining import joined_of
from rorg.manifest.effective import effective
from rorg.manifest.load import load, load_or_raise
from rorg.model.joining import resolved
from rorg.model.units import stamp

BASE = {"container": {"network_mode": "none", "ipc": "shareable"}, "update": {"bake": "0s"}}
JOINED = {
    "scan": {"container": {"network_mode": "service:base", "ipc": "service:base"}, "always_on": True},
    "peer": {"container": {"pid": "service:base", "network_mode": "none"}, "always_on": True},
    "logs": {"container": {"volumes_from": ["base:ro"], "network_mode": "none"}, "always_on": True},
}


def namespace(robot, service: str, kind: str) -> str:
    return os.readlink(f"/proc/{robot.container(service).pid}/ns/{kind}")


def shared(robot, joined=frozenset(JOINED)) -> bool:
    """All of them run, and in the namespaces of the container of `base` that runs."""
    if robot.active() != {"base", *joined}:
        return False
    pairs = [(name, kind) for name, kind in (("scan", "net"), ("scan", "ipc"), ("peer", "pid")) if name in joined]
    try:
        return all(namespace(robot, name, kind) == namespace(robot, "base", kind) for name, kind in pairs)
    except (FileNotFoundError, StopIteration):
        return False


def runs(robot) -> dict[str, str]:
    """Service -> the run that goes on, or the last one."""
    return {c.service: c.incarnation for c in sorted(robot.containers(), key=lambda c: (c.alive, c.started_at))}


@pytest.mark.smoke
def test_what_docker_runs_is_joined_and_follows_what_it_joins(docker_robot):
    robot = docker_robot
    robot.declare({"base": {**BASE, "container": {**BASE["container"], "volumes": ["/shared"]}}, **JOINED})
    robot.wait(lambda: shared(robot))
    robot.settle()
    logs = robot.engine.client.get(f"/containers/{robot.container('logs').id}/json")
    assert [(m["Destination"], m["RW"]) for m in logs["Mounts"]] == [("/shared", False)]

    before = runs(robot)
    robot.change(lambda d: replace(d, restarts={**d.restarts, "base": stamp(robot.wall())}))
    robot.wait(lambda: runs(robot).get("base") != before["base"] and shared(robot))
    robot.settle()
    after = runs(robot)
    assert after["logs"] == before["logs"], "volumes outlive a run"
    assert [after[n][:12] == before[n][:12] for n in JOINED] == [True] * 3, "the containers are the same"

    write_tree(robot.tree, {"base": {**BASE, "container": {**BASE["container"], "hostname": "base"}}, **JOINED})
    robot.wait(lambda: runs(robot).get("base", "")[:12] not in ("", before["base"][:12]) and shared(robot), 120)
    robot.settle()
    base, found = robot.container("base"), runs(robot)
    for name in JOINED:
        assert joined_of(robot.container(name).joined) == {"base": base.id}
        assert found[name][:12] != before[name][:12]
        assert robot.container(name).digest == desire(load_or_raise(robot.tree)).digests[name]


def test_what_is_joined_is_removed_after_what_joins_it(docker_robot):
    """Podman removes no container that another one is joined to."""
    robot = docker_robot
    robot.declare({"base": BASE, **JOINED, "other": {}})
    robot.wait(lambda: shared(robot))
    first = robot.container("base").id
    changed = {**BASE, "container": {**BASE["container"], "hostname": "base"}}
    write_tree(robot.tree, {"base": changed, **JOINED, "other": {}})
    robot.wait(lambda: first not in {c.id for c in robot.containers()} and shared(robot), 120)
    robot.settle()
    write_tree(robot.tree, {"other": {}})
    robot.wait(lambda: set(robot.states()) == {"other"}, 120)
    assert not [line for line in robot.log() if "failed" in line], robot.log()


def test_where_a_change_fails_what_joins_it_is_as_before(docker_robot):
    robot = docker_robot
    scan = {"scan": JOINED["scan"]}
    base = {**BASE, "update": {"bake": "2s"}}
    robot.declare({"base": base, **scan})
    robot.wait(lambda: robot.active() == {"base", "scan"})
    robot.settle()
    before = robot.container("base").id
    write_tree(robot.tree, {"base": {**base, "command": ["/no/such/program"]}, **scan})
    robot.wait(lambda: "its change failed" in robot.waits("base"))
    # What joins it is restarted once it is ready again.
    robot.wait(lambda: robot.container("base").id == before and shared(robot, {"scan"}))


def test_a_joined_container_is_made_again_with_what_it_joins(tmp_path):
    robot = VirtualRobot(tmp_path)
    robot.declare({"base": BASE, **JOINED})
    robot.settle()
    first = {name: robot.container(name).id for name in JOINED}
    assert all(joined_of(robot.container(n).joined) == {"base": robot.container("base").id} for n in JOINED)
    robot.declare({"base": {**BASE, "container": {**BASE["container"], "hostname": "base"}}, **JOINED})
    robot.settle()
    for name in JOINED:
        assert joined_of(robot.container(name).joined) == {"base": robot.container("base").id}
        assert robot.container(name).id != first[name]
    assert len(robot.containers()) == 4


def test_what_joins_needs_and_follows_what_it_joins(tmp_path):
    write_tree(tmp_path, {"base": BASE, **JOINED, "db": {"container": {"volumes_from": ["container:base", "base"]}}})
    services = load_or_raise(tmp_path).services
    assert services["scan"].joins == {"base": ("network_mode", "ipc")}
    assert services["scan"].needs == services["scan"].restarts_with == ("base",)
    assert services["logs"].needs == ("base",)
    assert services["logs"].restarts_with == ()
    assert services["db"].joins == {"base": ("volumes_from",)}


def test_an_implied_need_is_explained_with_the_option_that_says_so(tmp_path):
    profile = {"lab": {"container": {"network_mode": "service:base"}}}
    scan = {"profile": "lab", "needs": ["lidar"], "container": {"volumes_from": ["lidar"]}}
    write_tree(tmp_path, {"base": {}, "lidar": {}, "scan": scan, "it": JOINED["logs"]}, profiles=profile)
    told = {v.field: (v.value, str(v.where)) for v in effective(tmp_path, "scan") if v.field.startswith("needs")}
    assert [value for value, _ in told.values()] == ["lidar", {"service": "base", "restart": True}]
    assert "profiles/lab.yaml:7" in told["needs[1]"][1]


@pytest.mark.parametrize(
    ("options", "joins", "expected"),
    [
        ({"network_mode": "service:a"}, {"a": ("network_mode",)}, {"network_mode": "container:1"}),
        (
            {"volumes_from": ["a:ro", "ab", "container:a", "b"]},
            {"a": ("volumes_from",)},
            ["1:ro", "ab", "container:a", "b"],
        ),
        ({"volumes_from": ["a", "b"]}, {"a": ("volumes_from",), "b": ("volumes_from",)}, ["1", "2"]),
    ],
)
def test_names_of_services_become_ids_of_containers(options, joins, expected):
    expected = expected if isinstance(expected, dict) else {"volumes_from": expected}
    assert resolved(options, joins, {"a": "1", "b": "2"}) == expected


WRONG = [
    ("network_mode: 'service:bsae'", "6:29: error: network_mode: unknown service 'bsae'; try 'base'"),
    ("pid: 'service:it'", "6:20: error: pid: 'it' is this service itself; try another service"),
    ("ipc: 'service:lab'", "6:20: error: ipc: the meta-service 'lab' has no container; try another"),
    ("ipc: 'service:all'", "6:20: error: ipc: 'all' is a group, and has no container; try one of its members"),
    (
        "ipc: 'service:base'",
        "6:20: error: ipc: 'base' declares no ipc, so its shared memory is its own; try ipc: shareable in base",
    ),
    (
        "pid: 'service:back'",
        "services need each other: back -> it -> back; drop one of these needs",
    ),
    (
        "volumes_from: [base, elsewhere]",
        "6:36: warning: volumes_from: no service 'elsewhere', so this is the name of a container; "
        "try container:elsewhere to say so",
    ),
    (
        "network_mode: 'service:base', hostname: it",
        "6:55: error: hostname is not for a container that uses another container's network; declare it there",
    ),
]


@pytest.mark.parametrize(("options", "said"), WRONG)
def test_what_cannot_be_joined_is_told_at_its_place(tmp_path, options, said):
    back = {"back": {"needs": ["it"]}} if "back" in options else {}
    write_tree(tmp_path, {"base": {}, "lab": {"type": "meta"}, **back}, groups={"all": {"services": ["base"]}})
    head = "apiVersion: rorg/v1\nkind: Service\nmetadata: {name: it}\nspec:\n  image: img\n"
    (tmp_path / "services/it.yaml").write_text(f"{head}  container: {{{options}}}\n")
    found = [str(d) for d in load(tmp_path).diagnostics]
    assert len(found) == 1, found
    assert found[0].endswith(said)


def test_on_the_process_engine_shared_memory_is_the_machines_anyway(tmp_path):
    write_tree(tmp_path, {"base": {}, "it": {"container": {"ipc": "service:base", "volumes_from": ["base"]}}})
    assert [d.message for d in load(tmp_path, engine="docker").errors]
    (told,) = (d for d in load(tmp_path, engine="process").diagnostics if "mounts nothing" in d.message)
    assert (told.severity, told.where.line) == ("warning", 21)
