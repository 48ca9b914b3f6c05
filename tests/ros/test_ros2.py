"""Real DDS: with the profile `ros2` all messages arrive, and what delivers none is what `rorg validate` finds."""

from __future__ import annotations

import json

import pytest
from commands import rorg

pytestmark = pytest.mark.docker
NOTHING = "received 0 of 50"


def pair(image: str, topic: str, seconds: float, **containers: dict) -> dict[str, dict]:
    """A talker and a listener, of three lines each beside what is said of their containers."""
    return {
        name: {
            "image": image,
            "command": f"dds_{name} {topic} {seconds}",
            "profile": "ros2",
            **({"container": containers[name]} if name in containers else {}),
        }
        for name in ("talker", "listener")
    }


def shared(robot, *names: str) -> dict[str, dict]:
    """Participants over the robot's folder in place of /dev/shm."""
    robot.shm.mkdir(mode=0o1777)
    return {
        name: {
            "image": "dds-nodes",
            "command": f"dds_listener /{name} 600",
            "profile": "ros2",
            "restart": "never",
            "container": {"volumes": [f"{robot.shm}:/dev/shm"]},
        }
        for name in names
    }


def files(robot) -> set[str]:
    return {path.name for path in robot.shm.iterdir()}


def purged(robot) -> bool:
    return any("of dead ROS 2 participants removed" in line for line in robot.log())


def found(robot) -> set[str]:
    """Codes of what `rorg validate` finds in its tree."""
    return {f["code"] for f in json.loads(rorg("validate", str(robot.tree), "-o", "json").stdout)}


def run(robot, services: dict[str, dict]) -> dict[str, str]:
    """What both say when they have come to their ends."""
    robot.declare(services)
    robot.request(*services)
    robot.wait(lambda: robot.active() == set(services))
    api = robot.engine.api()

    def said() -> dict[str, str]:
        lines = {name: api.logs(robot.container(name).id).decode() for name in services}
        return lines if "sent 50" in lines["talker"] and " of 50" in lines["listener"] else {}

    last: dict[str, str] = {}
    robot.wait(lambda: last.update(said()) or last, 150)
    robot.release()
    robot.wait(lambda: not robot.active())  # signed off: nothing of them stays in /dev/shm
    return last


@pytest.fixture
def topic(tmp_path) -> str:
    """One that no other robot of this machine has."""
    return f"/chatter_{tmp_path.parent.name}_{tmp_path.name}".replace("-", "_")


def test_all_messages_arrive_between_services_of_three_lines(docker_robot, dds_image, topic):
    said = run(docker_robot, pair(dds_image, topic, 60))
    assert (said["listener"], said["talker"]) == (
        "received 50 of 50: matched\n",
        "sent 50: matched, acknowledged\n",
    )
    assert found(docker_robot) == set()


def distro(name: str) -> dict:
    return {"environment": {"ROS_DISTRO": name}}


@pytest.mark.parametrize(
    ("code", "containers"),
    [
        ("ros2-host-net-private-ipc", {"listener": {"ipc": "private"}}),
        ("ros2-mixed-uid", {"listener": {"user": "1000", "environment": {"ROS_HOME": "/tmp/ros"}}}),
        ("ros2-domain-mismatch", {"listener": {"environment": {"ROS_DOMAIN_ID": "7"}}}),
        ("ros2-release-mismatch", {"talker": distro("humble"), "listener": distro("jazzy")}),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_delivers_nothing_is_found_before_it_runs(docker_robot, dds_image, topic, code, containers):
    said = run(docker_robot, pair(dds_image, topic, 5, **containers))
    assert said["listener"].startswith(NOTHING), said
    assert "not acknowledged" in said["talker"]
    assert found(docker_robot) == {code}


@pytest.mark.parametrize(
    ("code", "containers"),
    [
        ("", {"talker": {"ipc": "shareable"}, "listener": {"ipc": "service:talker"}}),
        ("", {"talker": distro("jazzy"), "listener": distro("jazzy")}),
        ("ros2-discovery-mismatch", {"listener": {"environment": {"ROS_LOCALHOST_ONLY": "0"}}}),
    ],
    ids=["memory of another service", "jazzy", "found from other machines"],
)
def test_what_delivers_all_is_not_said_to_deliver_nothing(docker_robot, dds_image, topic, code, containers):
    said = run(docker_robot, pair(dds_image, topic, 60, **containers))
    assert said["listener"].startswith("received 50 of 50")
    assert found(docker_robot) == ({code} if code else set())


def test_what_killed_participants_left_is_removed_once_none_runs(docker_robot, dds_image):
    docker_robot.declare(shared(docker_robot, "victim", "other"), policies={"robot": {"purge_shm": True}})
    docker_robot.request("victim", id="victim")
    docker_robot.request("other", id="other")
    docker_robot.wait(lambda: len([f for f in files(docker_robot) if f.endswith("_el")]) >= 4)
    foreign = docker_robot.shm / "fastrtps_00c0ffee00c0ffee"
    (docker_robot.shm / "of_somebody_else").write_bytes(b"x")
    with foreign.open("wb"):  # a participant that rorg knows nothing of
        docker_robot.kill("victim")
        docker_robot.wait(lambda: "exited" in docker_robot.status()["services"]["victim"]["state"])
        left = files(docker_robot)
        assert not purged(docker_robot)
        docker_robot.kill("other")
        docker_robot.wait(lambda: purged(docker_robot))
        assert len(left) > 8
        assert files(docker_robot) == {foreign.name, "of_somebody_else"}
    (event,) = [e for e in docker_robot.loop.recorder.journal.since(0) if e["kind"] == "shm-purged"]
    assert event["bytes"] > 2 * 500_000, "each participant has a segment of half a megabyte"
