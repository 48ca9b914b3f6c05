"""Any robot can be run with stand-ins: who needs whom stays, what only the real programs have goes."""

from __future__ import annotations

from pathlib import Path

import pytest
from robots import write_tree

from rorg.manifest.load import load_or_raise
from rorg.model.catalog import Catalog
from rorg.model.probe import Probe
from rorg.tools.sim.emulate import Share, share_of, stand_ins

SERVICES = {
    "base": {"always_on": True, "resources": {"cpu": 1, "memory": "1Gi"}, "ready": {"tcp": 7001, "timeout": "9s"}},
    "arm": {
        "needs": ["base"],
        "idle": {"action": "pause", "linger": "3s"},
        "resources": {"cpu": 0.5, "memory": "100Mi"},
        "ready": {"ros_node": "/arm", "timeout": "20s"},
        "driver": {"devices": ["/dev/nothing"]},
        "container": {"volumes": ["/opt:/opt:ro"], "environment": {"SECRET": "hush-hush"}},
    },
    "hand": {"needs": ["arm"], "ready": {"delay": "2s"}, "priority": 70},
    "eyes": {
        "ready": {"all": [{"ros_node": "/eyes"}, {"tcp": 7002}]},
        "idle": {"action": "pause", "connected": "stop"},
    },
    "move": {"ready": {"completed": True}, "restart": "never"},
    "other": {"conflicts": ["hand"], "ready": {"tcp": "elsewhere:80"}},
}


@pytest.fixture
def catalog(tmp_path: Path) -> Catalog:
    policies = {"one": {"pressure": {"high": 0.9, "low": 0.5}}}
    return load_or_raise(write_tree(tmp_path / "tree", SERVICES, policies=policies))


def test_what_services_are_to_each_other_stays(catalog):
    found = stand_ins(catalog, {}, Share(0.5, 0.25), "it-").services
    for name in SERVICES:
        for field in ("needs", "conflicts", "always_on", "priority", "protected", "restart"):
            assert getattr(found[name], field) == getattr(catalog.services[name], field)
    assert found["arm"].idle == catalog.services["arm"].idle
    assert found["eyes"].idle.connected == "pause"
    assert found["developer"] == catalog.services["developer"]


def test_they_use_their_share_of_what_is_declared(catalog):
    arm = stand_ins(catalog, {}, Share(0.5, 0.25), "it-").services["arm"]
    assert (arm.cpu, arm.memory) == (0.25, 25 << 20)
    assert arm.spec["environment"] == {"RORG_SERVICE": "arm", "STANDIN_CPU": "0.2500", "STANDIN_MEMORY": "26214400"}


def test_nothing_of_the_robot_is_used(catalog):
    found = stand_ins(catalog, {}, Share(), "it-")
    assert found.policy.pressure is None
    assert (found.networks, found.volumes) == ({}, {})
    for name in SERVICES:
        service = found.services[name]
        assert service.spec["container_name"] == f"it-{name}"
        assert not service.devices
        assert not {"volumes", "devices", "command"} & service.spec.keys()


@pytest.mark.parametrize(
    ("service", "probe", "variable"),
    [
        ("base", Probe("tcp", "127.0.0.1:7001", 9.0), ("STANDIN_READY", "tcp:7001")),
        ("arm", Probe("delay", 0.1, 20.0), None),
        ("hand", Probe("delay", 2.0), None),
        ("eyes", Probe("tcp", "127.0.0.1:7002"), ("STANDIN_READY", "tcp:7002")),
        ("other", Probe("delay", 0.1), None),
        ("move", None, ("STANDIN_EXIT_AFTER", "1")),
    ],
)
def test_probes_are_such_that_a_stand_in_answers(catalog, service, probe, variable):
    found = stand_ins(catalog, {}, Share(), "it-").services[service]
    assert found.ready == (probe or catalog.services[service].ready)
    told = {k: v for k, v in found.spec["environment"].items() if k in ("STANDIN_READY", "STANDIN_EXIT_AFTER")}
    assert told == (dict([variable]) if variable else {})


def test_the_share_is_a_quarter_of_the_machine_at_the_most(catalog):
    assert share_of(catalog, ["base", "arm"], 2, 16 << 30) == Share(0.333, 1.0)
    assert share_of(catalog, ["base"], 8, 1 << 30) == Share(1.0, 0.25)
    assert share_of(catalog, ["hand"], 1, 1 << 30) == Share()
