"""A paused service runs again while it is stopped, so its end needs the room that a run needs (rorg/core/room.py)."""

from __future__ import annotations

import pytest

PROGRAM = """
import signal, sys, time

name, path = sys.argv[1:]

def write(text, times=1):
    for _ in range(times):
        with open(path, "a") as lines:
            lines.write(text + "\\n")
        time.sleep(0.02)

def end(number, frame):
    write(name, 20)
    write(name + " ended")
    sys.exit()

signal.signal(signal.SIGINT, end)
while True:
    write(name)
"""
"""Writes its name while it runs, and for another 0.4 s after it was asked to end."""
PAUSES = {"action": "pause", "escalate": {"after": "1s", "action": "stop"}}


@pytest.fixture
def diary(real_robot, tmp_path):
    """A function that makes a service which writes into a file, and one that reads the lines."""
    folder = tmp_path / "diary"
    folder.mkdir()
    folder.chmod(0o777)
    path = folder / "lines"
    mounts = {"container": {"volumes": [f"{folder}:{folder}"]}} if real_robot.kind == "docker" else {}

    def service(name: str, **more) -> dict:
        return {"command": ["python3", "-S", "-c", PROGRAM, name, str(path)], **mounts, **more}

    return service, lambda: path.read_text().splitlines() if path.exists() else []


def paused(robot, name: str, lines) -> None:
    """Have a service run, and then pause because nothing wants it."""
    robot.request(name, id=name)
    robot.wait(lambda: name in lines())
    robot.settle()
    robot.release(name)
    robot.wait(lambda: robot.states().get(name) == "paused")


def test_a_paused_service_does_not_end_beside_what_conflicts_with_it(real_robot, diary):
    robot, (service, lines) = real_robot, diary
    robot.declare({"nav": service("nav", idle=PAUSES), "map1": service("map1", conflicts=["nav"])})
    paused(robot, "nav", lines)
    robot.request("map1")
    robot.wait(lambda: robot.states().get("map1") == "running" and "map1" in lines())
    robot.wait(lambda: "a stop would resume it: conflicts with map1, which is active" in robot.waits("nav"))
    before = lines().count("nav")
    robot.wait(lambda: lines().count("map1") > 50)
    assert robot.states()["nav"] == "paused"
    assert lines().count("nav") == before

    robot.release()
    robot.wait(lambda: robot.states() == {"nav": "exited", "map1": "exited"})
    first, last = lines().index("map1"), lines().index("map1 ended")
    assert not [line for line in lines()[first:last] if line.startswith("nav")], "they ran together"
    assert "nav ended" in lines()[last:], "it was asked to end, and had the time for it"


def test_what_conflicts_waits_until_a_paused_service_has_ended(real_robot, diary):
    robot, (service, lines) = real_robot, diary
    robot.declare({"nav": service("nav", idle=PAUSES), "map1": service("map1", conflicts=["nav"])})
    paused(robot, "nav", lines)
    known = len(lines())
    robot.wait(lambda: len(lines()) > known)  # it is resumed to end
    robot.request("map1")
    robot.wait(lambda: "map1" in lines())
    assert "nav ended" in lines()[: lines().index("map1")]


def test_a_paused_service_without_room_to_end_is_killed_for_what_it_holds(real_robot, diary):
    robot, (service, lines) = real_robot, diary
    robot.declare(
        {
            "nav": service("nav", idle={"action": "pause"}, exclusive=["camera"]),
            "map1": service("map1", conflicts=["nav"]),
            "cam": service("cam", exclusive=["camera"]),
        }
    )
    paused(robot, "nav", lines)
    robot.request("map1", id="map")
    robot.wait(lambda: robot.states().get("map1") == "running")
    robot.request("cam", id="see")
    robot.wait(lambda: robot.active() == {"map1", "cam"})
    assert robot.container("nav").exit_code == 137
    assert "nav ended" not in lines()
    assert any("killed while paused" in line for line in robot.log()), robot.log()
