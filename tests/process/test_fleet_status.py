"""`rorg fleet status`: many robots in one table."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest
from common import free_port
from computers import Computer, Team

ROBOTS = 200


@pytest.fixture(scope="module")
def robot(tmp_path_factory) -> Iterator[Computer]:
    folder = tmp_path_factory.mktemp("fleet")
    services = {"camera": {"image": "host", "command": "sleep infinity", "always_on": True}}
    team = Team(folder, {n: {**s, "machine": "base"} for n, s in services.items()}, ("base",))
    team.start()
    made = team.computers["base"]
    made.rorg("certificate", "--person", "ada", "--into", str(team.folder / "certificates"))
    yield made
    team.down()


def status(robot: Computer, robots: dict[str, str], *words: str) -> subprocess.CompletedProcess[str]:
    file, certificates = robot.folder / "robots.yaml", robot.certificates
    file.write_text("".join(f"{name}: https://{address}\n" for name, address in robots.items()))
    environment = {
        **os.environ,
        "RORG_CA": str(certificates / "authority.pem"),
        "RORG_CERT": str(certificates / "ada.pem"),
        "RORG_KEY": str(certificates / "ada.key"),
        "XDG_STATE_HOME": str(robot.folder / "home"),
    }
    command = [sys.executable, "-m", "rorg", "fleet", "status", str(file), *words]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)


@pytest.mark.slow
def test_it_says_how_each_robot_is_and_which_ones_do_not_answer(robot):
    nobody = f"127.0.0.1:{free_port()}"
    robot.wait("camera")
    done = status(robot, {"nora": robot.address, "emil": nobody}, "-o", "json")
    assert done.returncode == 0, done.stderr
    nora, emil = json.loads(done.stdout)
    assert (nora["health"], nora["drift"], nora["machine"], nora["error"]) == ({"Healthy": 1}, 0, "base", "")
    assert emil["error"]
    assert emil["seen_at"] == ""
    table = status(robot, {"nora": robot.address, "emil": nobody}).stdout
    assert "1 Healthy" in table
    assert "never reached" in table
    table = status(robot, {"nora": nobody}).stdout
    assert f"unreachable since {time.strftime('%Y-')}" in table


@pytest.mark.slow
def test_two_hundred_robots_take_less_than_three_seconds(robot):
    """All of them are one robot here, so its server works for 200."""
    robots = {f"robot{number}": robot.address for number in range(ROBOTS)}
    began = time.monotonic()
    done = status(robot, robots, "-o", "json", "--timeout", "30s")
    took = time.monotonic() - began
    answers = json.loads(done.stdout)
    assert [a for a in answers if a["error"]] == []
    print(f"fleet: {ROBOTS} robots in {took:.1f} s")
    assert took < 3 or os.getloadavg()[0] > 2


@pytest.mark.slow
def test_a_file_that_is_no_list_of_robots_is_refused(robot):
    for text in (
        "",
        "- nora\n",
        "nora: http://nora:1\n",
        "a: [b]\n",
        "nora: 1" + ":1" * 9000 + "\n",
        "nora: !!int x\n",
    ):
        (robot.folder / "bad.yaml").write_text(text)
        done = robot.rorg("fleet", "status", str(robot.folder / "bad.yaml"))
        assert (done.returncode, "https://nora:7878" in done.stderr) == (2, True), text
