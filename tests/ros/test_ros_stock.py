"""Programs of a stock ROS image, run with manifests of three lines each; and the page on them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import commands
import pages
import pytest
from common import ROOT, alone_on_the_machine, wait_for
from page_preparation import PREPARE
from robots import Daemon

pytestmark = pytest.mark.docker
SERVICE = "apiVersion: rorg/v1\nkind: Service\nmetadata: {{name: {name}}}\nspec:\n"
TALKING = {
    "roscore": "  command: roscore\n  profile: ros1\n  ready: {ros_node: /rosout}\n",
    "talker": "  command: rostopic pub -r 10 /chatter std_msgs/String hello\n  profile: ros1\n",
    "listener": "  command: rostopic echo /chatter\n  profile: ros1\n",
}
"""With the line `image` the talker's and the listener's `spec` has three lines."""


@pytest.fixture
def default_master() -> Iterator[None]:
    """The port at which ROS looks for its master is ours: other runs of these tests on this machine wait."""
    with alone_on_the_machine("port-11311"):
        yield


@pytest.fixture
def daemon(docker_robot, ros_image, default_master) -> Daemon:
    """`rorg run` over the three manifests."""
    folder = docker_robot.tree / "services"
    folder.mkdir(parents=True)
    for name, lines in TALKING.items():
        (folder / f"{name}.yaml").write_text(SERVICE.format(name=name) + f"  image: {ros_image}\n{lines}")
    found = Daemon(docker_robot)
    found.start()
    wait_for(lambda: Path(docker_robot.socket()).exists())
    return found


def rorg(daemon: Daemon, *words: str) -> str:
    """What a command says to a person."""
    return commands.rorg(*words, RORG_STATE_DIR=str(daemon.robot.state.path)).stdout


def heard(daemon: Daemon) -> bool:
    """Whether the run that the listener is in has heard the talker."""
    since = daemon.robot.container("listener").started_at
    return 'data: "hello"' in rorg(daemon, "logs", "listener", "--since", since)


def test_talker_and_listener_of_a_stock_image_find_each_other_and_survive_their_master(daemon):
    robot = daemon.robot
    assert json.loads(rorg(daemon, "validate", str(robot.tree), "-o", "json")) == []
    rorg(daemon, "request", "talker", "listener", "--wait")
    wait_for(lambda: heard(daemon), what="the listener hears the talker")
    before = {c.service: c.incarnation for c in robot.containers()}
    robot.kill("roscore")
    robot.wait(lambda: all(c.active and c.incarnation != before[c.service] for c in robot.containers()))
    wait_for(lambda: heard(daemon), what="they are back after their master was killed")


HEADINGS = ("ROS 1: a talker, a listener, and their master", "ROS 1: parameters")
STEPS = pages.steps(ROOT / "docs/how-to/ros.md", HEADINGS)


def test_the_page_word_for_word(dockerd, ros_image, default_master, tmp_path):
    pages.run(STEPS, PREPARE, tmp_path, DOCKER_HOST=dockerd.host)
