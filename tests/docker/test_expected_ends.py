"""Which ends count as unexpected: not that of a completed task, nor one that comes with the engine's own end."""

from __future__ import annotations

import pytest
from common import wait_for
from robots import RealRobot

from rorg.history.journal import Filter

TASK = {"restart": "on-failure", "always_on": True}
EATER = ["python3", "-S", "-c", "x = [bytearray(1 << 20) for _ in range(400)]"]


def shown(robot: RealRobot, service: str) -> dict:
    """The service as rorg shows it; nothing before the first pass."""
    return robot.status().get("services", {}).get(service, {"state": "", "health": "", "crashes": 0, "conditions": []})


def ends(robot: RealRobot) -> list[str]:
    """What the journal says of unexpected ends."""
    return [e["message"] for e in robot.loop.recorder.journal.select(Filter(kinds=frozenset({"crashed"})), 99)]


@pytest.mark.parametrize("ready", [{"completed": True}, None])
def test_a_service_that_completes_has_no_unexpected_exit(real_robot, ready):
    task = {
        "command": ["sh", "-c", "exit 0"],
        "restart": "on-failure",
        "always_on": True,
        **({"ready": ready} if ready else {}),
    }
    real_robot.declare({"homing": task})
    real_robot.wait(lambda: shown(real_robot, "homing")["health"] == "Completed")
    real_robot.settle()
    assert shown(real_robot, "homing")["crashes"] == 0
    assert ends(real_robot) == []


def test_a_service_that_fails_and_then_completes_is_well(real_robot, tmp_path):
    tries = tmp_path / "tries"
    tries.mkdir()
    program = f"import os; n = len(os.listdir('{tries}')); os.mkdir(f'{tries}/{{n}}'); os._exit((3, 4, 0)[n])"
    task = {
        "command": ["python3", "-S", "-c", program],
        "restart": "on-failure",
        "always_on": True,
        "ready": {"completed": True},
    }
    real_robot.declare({"homing": {**task, "container": {"volumes": [f"{tries}:{tries}"]}}})
    real_robot.wait(lambda: shown(real_robot, "homing")["health"] == "Completed")
    found = shown(real_robot, "homing")
    assert (found["crashes"], found["exits"], found["message"]) == (2, 0, "")
    assert len(ends(real_robot)) == 2


def test_an_end_of_the_engine_is_none_of_its_services(tmp_path, dockerd):
    if not hasattr(dockerd, "folder"):
        pytest.skip("somebody else runs this engine")
    robot = RealRobot(tmp_path, "docker", dockerd.host)
    robot.declare({"arm": {"always_on": True}, "base": {"always_on": True}})
    robot.wait(lambda: shown(robot, "arm")["health"] == shown(robot, "base")["health"] == "Healthy")
    before = {n: robot.run_of(n) for n in ("arm", "base")}
    dockerd.stop()
    dockerd.start()
    wait_for(lambda: all(shown(robot, n).get("incarnation") not in ("", before[n]) for n in before), 90)
    robot.settle()
    assert [shown(robot, n)["crashes"] for n in before] == [0, 0]
    assert ends(robot) == []
    robot.close()


def test_each_end_by_the_memory_limit_is_called_so(docker_robot):
    eater = {"command": EATER, "restart": "always", "always_on": True, "container": {"mem_limit": "30Mi"}}
    docker_robot.declare({"arm": eater})
    for number in 1, 2, 3:
        docker_robot.wait(lambda number=number: shown(docker_robot, "arm")["crashes"] >= number)
    docker_robot.wait(lambda: (found := shown(docker_robot, "arm"))["state"] == "exited" and found["crashes"] >= 3)
    (ready,) = (c for c in shown(docker_robot, "arm")["conditions"] if c["type"] == "Ready")
    assert (ready["reason"], ready["message"]) == ("OutOfMemory", "killed: out of memory")
    assert all("out of memory" in end for end in ends(docker_robot))
