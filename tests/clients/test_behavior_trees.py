"""The leaves of docs/how-to/behavior-trees.md, taken from the page, on a robot that runs."""

from __future__ import annotations

import os
import re
import subprocess

import py_trees
import pytest
from common import ROOT, wait_for
from py_trees.common import Status
from robots import RealRobot
from tools import tool

PAGE = (ROOT / "docs/how-to/behavior-trees.md").read_text()
TREE = {"camera": {"ready": {"exec": ["true"], "interval": "50ms"}}, "arm": {}, "lidar": {"conflicts": ["arm"]}}
MAIN = """
#include <chrono>
#include <iostream>
#include <thread>
int main(int, char** words) {
  const BT::NodeConfig config{{{"service", words[1]}}};
  HoldService hold("hold", config);
  ServiceReady ready("ready", config);
  for (std::string line; std::getline(std::cin, line);) {
    if (line == "hold") std::cout << static_cast<int>(hold.executeTick()) << std::endl;
    if (line == "ready") std::cout << static_cast<int>(ready.executeTick()) << std::endl;
    if (line == "halt") {
      hold.haltNode();
      std::cout << "halted" << std::endl;
    }
  }
}
"""


def code(language: str) -> str:
    return re.search(rf"```{language}\n(.*?)```", PAGE, re.S)[1]


@pytest.fixture
def robot(tmp_path, monkeypatch):
    found = RealRobot(tmp_path, "process", None, with_server=True)
    found.declare(TREE)
    found.wait(lambda: len(found.containers()) == len(TREE))
    monkeypatch.setenv("RORG_SOCKET", found.socket())
    yield found
    found.close()


@pytest.fixture
def leaves(robot, monkeypatch) -> dict:
    import rorg_client

    monkeypatch.setattr(rorg_client, "_shared", None)  # that of another test's robot
    found: dict = {}
    exec(code("python"), found)
    return found


class Drive(py_trees.behaviour.Behaviour):
    """Succeeds when it is told so; remembers what ran when it began."""

    def __init__(self, robot: RealRobot) -> None:
        super().__init__("drive")
        self.robot, self.began, self.arrived = robot, None, False

    def initialise(self) -> None:
        self.began = self.robot.active()

    def update(self) -> Status:
        return Status.SUCCESS if self.arrived else Status.RUNNING


def test_a_branch_holds_what_it_needs_until_it_has_succeeded(robot, leaves):
    drive = Drive(robot)
    tree = leaves["with_services"](drive, "camera")
    assert robot.active() == set()
    wait_for(lambda: (tree.tick_once(), drive.began)[1], what="the task begins")
    assert drive.began == {"camera"}, "only then, when it is ready"
    drive.arrived = True
    tree.tick_once()
    assert tree.status == Status.SUCCESS
    robot.wait(lambda: robot.active() == set())


def test_a_branch_that_is_interrupted_lets_go(robot, leaves):
    tree = leaves["with_services"](Drive(robot), "camera")
    wait_for(lambda: (tree.tick_once(), robot.active())[1] == {"camera"}, what="the camera runs")
    tree.stop(Status.INVALID)
    robot.wait(lambda: robot.active() == set())


def test_a_branch_fails_when_its_service_is_lost(robot, leaves):
    drive = Drive(robot)
    tree = leaves["with_services"](drive, "camera")
    wait_for(lambda: (tree.tick_once(), drive.began)[1], what="the task begins")
    robot.kill("camera")
    wait_for(lambda: (tree.tick_once(), tree.status == Status.FAILURE)[1], what="the branch fails")
    assert "camera" in tree.children[0].feedback_message
    assert drive.status == Status.INVALID, "the task was ended"
    robot.wait(lambda: robot.active() == set())


def test_a_branch_fails_when_its_service_does_not_come_up(robot, leaves):
    robot.declare({**TREE, "camera": {"ready": {"exec": ["false"], "interval": "50ms"}}})
    robot.wait(lambda: sum("manifests in force" in line for line in robot.log()) == 2)
    hold = leaves["HoldServices"]("camera", timeout=0.5)
    wait_for(lambda: (hold.tick_once(), hold.status == Status.FAILURE)[1], what="the leaf fails")
    assert "camera" in hold.feedback_message


@pytest.mark.slow
def test_the_leaves_for_cpp(robot, tmp_path):
    (tmp_path / "leaves.cpp").write_text(code("cpp") + MAIN)
    program = tmp_path / "leaves"
    flags = ["-std=c++17", "-Wall", "-Wextra", "-Werror", "-pthread"]
    where = [f"-I{ROOT / 'clients/cpp/include'}", f"-I{ROOT / 'tests/clients'}"]
    subprocess.run([tool("g++"), *flags, *where, tmp_path / "leaves.cpp", "-o", program], check=True)
    environment = {**os.environ, "RORG_SOCKET": robot.socket()}
    with subprocess.Popen(
        [program, "camera"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
    ) as running:

        def say(word: str) -> str:
            running.stdin.write(word + "\n")
            running.stdin.flush()
            return running.stdout.readline().strip()

        began, succeeded, failed = "1", "2", "3"
        assert (say("ready"), say("hold")) == (began, began)
        wait_for(lambda: say("ready") == succeeded, what="the camera is ready")
        assert say("hold") == began
        assert say("halt") == "halted"
        robot.wait(lambda: robot.active() == set())
        say("hold")
        wait_for(lambda: say("ready") == succeeded, what="the camera is ready again")
        assert say("hold") == began
        robot.kill("camera")
        wait_for(lambda: say("hold") == failed, what="the loss fails the leaf")
        running.stdin.close()
        assert running.wait(20) == 0
