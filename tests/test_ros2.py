"""Real DDS: with the profile `ros2` all messages arrive, and what delivers none is what `rorg validate` finds."""

from __future__ import annotations

import json

import pytest
from commands import rorg

pytestmark = pytest.mark.docker
NOTHING = "received 0 of 50"


def pair(image: str, topic: str, seconds: float, **listener: dict) -> dict[str, dict]:
    """A talker and a listener, of three lines each unless the listener's container is said to be another."""
    tree = {
        "talker": {"image": image, "command": f"dds_talker {topic} {seconds}", "profile": "ros2"},
        "listener": {"image": image, "command": f"dds_listener {topic} {seconds}", "profile": "ros2"},
    }
    return {**tree, "listener": {**tree["listener"], **({"container": listener} if listener else {})}}


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


@pytest.mark.parametrize(
    ("container", "code"),
    [
        ({"ipc": "private"}, "ros2-host-net-private-ipc"),
        ({"user": "1000"}, "ros2-mixed-uid"),
        ({"environment": {"ROS_DOMAIN_ID": "7"}}, "ros2-domain-mismatch"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_delivers_nothing_is_found_before_it_runs(docker_robot, dds_image, topic, container, code):
    services = pair(dds_image, topic, 5, **container)
    said = run(docker_robot, services)
    assert said["listener"].startswith(NOTHING), said
    assert "not acknowledged" in said["talker"]
    assert found(docker_robot) == {code}
