"""A mistake in a manifest, and then a reboot: rorg begins with what was in force before."""

from __future__ import annotations

import json
from hashlib import sha256

import pytest
from common import ROOT, wait_for
from rorg_process import RorgProcess

from rorg.manifest.load import load
from rorg.model.catalog import Service
from rorg.model.former import Former, Kept
from rorg.store.last_good import NAME, read_kept, read_last_catalog, write_kept


@pytest.fixture
def robot(tmp_path):
    policy = {"robot": {"resources": {"bus": 2}}}
    services = {"arm": {"always_on": True}, "leg": {"exclusive": ["bus"]}, "cam": {"labels": {"secret": "x"}}}
    found = RorgProcess(tmp_path, services, policies=policy).start()
    yield found
    found.close()


def spoil(robot: RorgProcess) -> str:
    """Make a mistake in a manifest; return its text before."""
    path = robot.tree / "services/leg.yaml"
    text = path.read_text()
    path.write_text(text.replace("spec:", "spec:\n  imgae: x"))
    return text


@pytest.mark.slow
def test_a_robot_that_begins_beside_a_mistake_has_what_was_in_force(robot):
    client = robot.client(patience=30)
    client.wait("arm", timeout=30)
    client.request("leg", id="walk", ttl=None, wait=30)
    client.hold("cam", 600, "cleaning")
    runs = {s["service"]: s["incarnation"] for s in client.services()}
    pid = client.service("arm")["pid"]
    robot.stop(kill=True)
    before = spoil(robot)
    robot.kill_service(pid)
    robot.start()
    wait_for(lambda: client.status()["tree"]["errors"])
    wait_for(lambda: client.service("arm")["health"] == "Healthy")
    found = {s["service"]: s for s in client.services()}
    assert found["leg"]["incarnation"] == runs["leg"], "what runs goes on"
    assert "cleaning" in found["cam"]["held"]
    client.release("walk", requester="developer")
    wait_for(lambda: client.service("leg")["state"] == "exited")
    client.request("leg", id="walk", ttl=None, wait=30)
    assert "the last good manifests stay in force" in robot.told()
    (robot.tree / "services/leg.yaml").write_text(before)
    wait_for(lambda: not client.status()["tree"]["errors"])
    assert client.service("leg")["health"] == "Healthy"


@pytest.mark.slow
def test_what_another_version_wrote_is_left_alone(robot):
    robot.client(patience=30).wait("arm", timeout=30)
    robot.stop(kill=True)
    path = robot.state / NAME
    for damaged in ("", "{", json.dumps({"last": {"services": {"arm": {"new": 1}}}, "digest": "x"})):
        path.write_text(damaged)
        assert read_last_catalog(robot.state) is None
    spoil(robot)
    robot.start()
    wait_for(lambda: robot.client(patience=30).status()["tree"]["errors"])
    assert {s["service"] for s in robot.client().services()} == {"developer"}


def test_what_an_earlier_version_wrote_of_prewarming_is_ignored(tmp_path):
    catalog = load(ROOT / "manifests").catalog
    former = {"bell": Former(Service("bell", spec={"image": "bell"}), groups=("all",))}
    write_kept(tmp_path, Kept(catalog, former))
    path = tmp_path / NAME
    content = json.loads(path.read_text())
    del content["digest"]
    for service in (*content["last"]["services"].values(), content["former"][0]["service"]):
        service["idle"]["prewarm"] = 0.2
    path.write_text(json.dumps({"digest": sha256(json.dumps(content).encode()).hexdigest(), **content}))
    assert read_last_catalog(tmp_path) == catalog
    kept = read_kept(tmp_path)
    assert kept.catalog is not None
    assert (kept.catalog.services, kept.former) == (catalog.services, former)


def test_a_whole_catalog_comes_back_as_it_was(tmp_path):
    catalog = load(ROOT / "manifests").catalog
    write_kept(tmp_path, Kept(catalog, {}))
    assert read_last_catalog(tmp_path) == catalog
