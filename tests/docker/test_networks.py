"""Networks and volumes on Docker: made, used again, kept over an update, removed with the robot; nobody else's is
touched."""

from __future__ import annotations

import re

import commands
import pytest
from common import BASE_IMAGE, wait_for
from robots import WORK, write_tree

from rorg.core.objects import LABELS
from rorg.core.observed import LABEL_OWNER
from rorg.engines.docker.client import Client

pytestmark = pytest.mark.docker

SERVICE = {"always_on": True, "container": {"networks": {"ros": {"aliases": ["base"]}}, "volumes": ["maps:/maps"]}}
NETWORKS = {"ros": {"name": "t15_ros", "ipam": {"config": [{"subnet": "10.213.0.0/24"}]}, "labels": {"team": "arms"}}}
PYTHON = ["python3", "-S", "-c"]
VOLUMES = {"maps": {"name": "t15_maps"}}


@pytest.fixture
def client(docker_robot):
    """The engine itself; networks and volumes of the test are gone afterwards."""
    found = Client(docker_robot.host)
    yield found
    docker_robot.close()
    for row in [n for n in found.get("/networks") if n["Name"].startswith("t15_")]:
        found.delete(f"/networks/{row['Id']}")
    for row in [v for v in found.get("/volumes")["Volumes"] or () if v["Name"].startswith("t15_")]:
        found.delete(f"/volumes/{row['Name']}")


def named(client: Client, kind: str, name: str) -> dict | None:
    rows = client.get("/networks") if kind == "network" else client.get("/volumes")["Volumes"] or []
    return next((row for row in rows if row["Name"] == name), None)


@pytest.mark.smoke
def test_they_are_made_and_used_again(docker_robot, client):
    robot = docker_robot
    robot.declare({"base": SERVICE, "lidar": SERVICE}, networks=NETWORKS, volumes=VOLUMES)
    robot.wait(lambda: robot.active() == {"base", "lidar"})
    network, volume = named(client, "network", "t15_ros"), named(client, "volume", "t15_maps")
    assert network["Labels"]["team"] == "arms"
    assert [pool["Subnet"] for pool in network["IPAM"]["Config"]] == ["10.213.0.0/24"]
    assert {network["Labels"][LABEL_OWNER], volume["Labels"][LABEL_OWNER]} == {robot.engine.owner}
    data = client.get(f"/containers/{robot.container('base').id}/json")
    joined = data["NetworkSettings"]["Networks"]["t15_ros"]
    assert "base" in joined["Aliases"]
    assert joined["NetworkID"] in (network["Id"], "t15_ros")  # Podman joins by name
    assert data["Mounts"][0]["Name"] == "t15_maps"
    assert robot.engine.exec(robot.container("base").id, [*PYTHON, "open('/maps/kept', 'w')"], 10)[0] == 0
    robot.settle()
    before = robot.container("base").id
    changed = {**SERVICE, "container": {**SERVICE["container"], "hostname": "other"}}
    robot.declare({"base": changed, "lidar": SERVICE}, networks=NETWORKS, volumes=VOLUMES)
    robot.wait(lambda: robot.container("base").id != before and robot.active() == {"base", "lidar"})
    assert robot.engine.exec(robot.container("base").id, [*PYTHON, "open('/maps/kept')"], 10)[0] == 0
    assert named(client, "network", "t15_ros")["Id"] == network["Id"]


def rorg(robot, *words: str, code: int = 0) -> str:
    environment = {"RORG_STATE_DIR": str(robot.state.path), "RORG_ENGINE": "docker", "DOCKER_HOST": robot.host}
    done = commands.rorg(*words, cwd=robot.tree, code=code, **environment)
    return done.stdout + done.stderr


def test_commands_show_them(docker_robot, client):
    """Where a rorg runs, and where none does."""
    robot = docker_robot
    write_tree(robot.tree, {"base": SERVICE}, networks=NETWORKS, volumes={**VOLUMES, "t15_site": {"external": True}})
    told = rorg(robot, "diff", "-o", "wide", code=1)
    assert re.search(r"\+ +create +network/ros +base uses it", told)
    assert re.search(r"\+ +create +base +no container, after network/ros, volume/maps", told)
    rorg(robot, "apply", "--yes")
    assert [line.split() for line in rorg(robot, "get", "networks").splitlines()] == [
        ["NAME", "STATE", "ENGINE", "SERVICES"],
        ["ros", "present", "t15_ros", "base"],
    ]
    robot.start()
    robot.wait(lambda: robot.active() == {"base"})
    assert [line.split() for line in rorg(robot, "get", "volumes", "-o", "wide").splitlines()] == [
        ["NAME", "STATE", "ENGINE", "SERVICES", "OURS", "DECLARED"],
        ["maps", "present", "t15_maps", "base", "yes", "yes"],
        ["t15_site", "none", "t15_site", "no", "yes"],
    ]
    assert "uses network/ros, uses volume/maps" in rorg(robot, "graph")
    assert '"base" -> "volume/maps";' in rorg(robot, "graph", "-o", "dot")
    robot.stop()
    blocked = {**SERVICE, "container": {"volumes": ["t15_site:/site"]}}
    write_tree(robot.tree, {"base": blocked}, volumes={"t15_site": {"external": True}})
    assert "docker volume create t15_site" in rorg(robot, "apply", "--yes", code=4)


def test_a_network_goes_with_its_manifest_and_a_volume_stays(docker_robot, client):
    robot = docker_robot
    robot.declare({"base": SERVICE}, networks=NETWORKS, volumes=VOLUMES)
    robot.wait(lambda: robot.active() == {"base"})
    robot.declare({"base": {"always_on": True}})
    robot.wait(lambda: named(client, "network", "t15_ros") is None)
    robot.settle()
    assert robot.active() == {"base"}
    assert named(client, "volume", "t15_maps")


def test_a_changed_network_is_made_anew_once_nobody_is_connected(docker_robot, client):
    robot = docker_robot
    robot.declare({"base": {**SERVICE, "always_on": False}}, networks=NETWORKS, volumes=VOLUMES)
    robot.request("base")
    robot.wait(lambda: robot.active() == {"base"})
    first = named(client, "network", "t15_ros")["Id"]
    changed = {"ros": {**NETWORKS["ros"], "internal": True}}
    robot.declare({"base": {**SERVICE, "always_on": False}}, networks=changed, volumes=VOLUMES)
    robot.wait(lambda: "connected: base" in robot.waits("network/ros"))
    assert robot.active() == {"base"}
    robot.release()
    robot.wait(lambda: (named(client, "network", "t15_ros") or {}).get("Id", first) != first)
    robot.request("base")
    robot.wait(lambda: robot.active() == {"base"})
    assert named(client, "network", "t15_ros")["Internal"]
    data = client.get(f"/containers/{robot.container('base').id}/json")
    assert set(data["NetworkSettings"]["Networks"]) == {"t15_ros"}


def test_what_somebody_else_made_is_never_touched(docker_robot, client):
    robot = docker_robot
    client.post("/networks/create", {"Name": "t15_ros"})
    client.post("/volumes/create", {"Name": "t15_maps", "Labels": {LABEL_OWNER: "another", LABELS["volume"]: "maps"}})
    robot.declare({"base": SERVICE}, networks=NETWORKS, volumes=VOLUMES)
    robot.wait(lambda: "external: true" in robot.waits("base"))
    assert "was not made by rorg" in robot.waits("network/ros")
    assert "belongs to another robot" in robot.waits("volume/maps")
    networks, volumes = ({n: {"name": s["name"], "external": True} for n, s in k.items()} for k in (NETWORKS, VOLUMES))
    robot.declare({"base": SERVICE}, networks=networks, volumes=volumes)
    robot.wait(lambda: robot.active() == {"base"})
    robot.declare({"base": {"always_on": True}})
    robot.wait(lambda: robot.active() == {"base"} and not robot.container("base").networks)
    robot.settle()
    robot.stop()
    down(robot, "--volumes")
    assert named(client, "network", "t15_ros")
    assert named(client, "volume", "t15_maps")


def down(robot, *words: str) -> str:
    return rorg(robot, "down", "--yes", *words)


@pytest.mark.parametrize("serving", [True, False])
def test_volumes_go_where_that_is_said(docker_robot, client, serving):
    robot = docker_robot
    robot.with_server = serving
    robot.declare({"base": SERVICE}, networks=NETWORKS, volumes=VOLUMES)
    robot.wait(lambda: robot.active() == {"base"})
    client.post("/volumes/create", {"Name": "t15_theirs"})
    if not serving:
        robot.stop()
    told = down(robot, "--volumes") if not serving else take_down(robot, volumes=True)
    wait_for(lambda: named(client, "network", "t15_ros") is None)
    wait_for(lambda: named(client, "volume", "t15_maps") is None)
    assert named(client, "volume", "t15_theirs")
    assert serving or "volume/t15_maps" in told


def take_down(robot, **said) -> str:
    """By its API: its loop ends by itself."""
    robot.client().call("PUT", "/v1/down", said)
    robot.thread.join(60)
    assert not robot.thread.is_alive()
    return ""


def test_down_keeps_volumes(docker_robot, client):
    robot = docker_robot
    robot.declare({"base": SERVICE}, networks=NETWORKS, volumes=VOLUMES)
    robot.wait(lambda: robot.active() == {"base"})
    robot.stop()
    told = down(robot)
    assert "stays; --volumes removes it" in told
    assert named(client, "network", "t15_ros") is None
    assert named(client, "volume", "t15_maps")


def test_a_network_that_somebody_else_uses_holds_nothing_up(docker_robot, client):
    """It stays, and that is told."""
    robot = docker_robot
    robot.declare({"base": SERVICE}, networks=NETWORKS, volumes=VOLUMES)
    robot.wait(lambda: robot.active() == {"base"})
    body = {"Image": BASE_IMAGE, "Cmd": WORK, "HostConfig": {"NetworkMode": "t15_ros"}}
    other = client.post("/containers/create", body, name="t15_other")["Id"]
    try:
        client.post(f"/containers/{other}/start")
        robot.stop()
        assert "connected to it: t15_other" in down(robot, "--volumes")
        assert named(client, "network", "t15_ros")
        assert named(client, "volume", "t15_maps") is None
    finally:
        client.delete(f"/containers/{other}", force=True)
