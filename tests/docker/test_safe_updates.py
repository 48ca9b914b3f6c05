"""A set of changes goes back on a real engine, and waits for the word of a person."""

from __future__ import annotations

import pytest
from changed_services import WELL, changed
from commands import rorg
from robots import WORK, RealRobot, write_tree
from updates import failed, running


@pytest.fixture(params=["process", pytest.param("docker", marks=pytest.mark.docker)])
def robot(request, tmp_path):
    host = request.getfixturevalue("dockerd").host if request.param == "docker" else None
    found = RealRobot(tmp_path, request.param, host, with_server=True)
    yield found
    found.close()


@pytest.mark.slow
def test_a_set_goes_back_and_is_tried_again_by_a_persons_word(robot):
    """nav is well at first, and map dies within its bake."""
    together = {"update": {"atomic": True, "bake": "20s"}}
    robot.declare({"nav": {**WELL, **together}, "map": {**WELL, **together}})
    robot.wait(lambda: robot.active() == {"nav", "map"})
    robot.settle()
    before = {n: robot.container(n).id for n in ("nav", "map")}
    dying = changed(1, command=["python3", "-S", "-c", "import time; time.sleep(1); raise SystemExit(3)"], **together)
    robot.declare({"nav": changed(1, command=WORK, **together), "map": dying})
    robot.wait(lambda: failed(robot, "map") and failed(robot, "nav"))
    robot.wait(lambda: {c.service: c.id for c in robot.containers()} == before and robot.active() == {"nav", "map"})
    assert "exit code 3" in failed(robot, "map")
    assert "it changes together with map" in failed(robot, "nav")
    where = {"RORG_SOCKET": robot.socket()}
    assert "no change of it failed" in rorg("retry", "nav", "developer", code=5, **where).stderr
    told = rorg("apply", str(robot.tree), "--yes", "--wait", code=4, RORG_STATE_DIR=str(robot.state.path)).stderr
    assert "map: its change failed" in told
    begun = sum("> start map (" in line for line in robot.lines)
    assert rorg("retry", "nav", **where).stdout == "nav, map: the change is tried again\n"
    robot.wait(lambda: sum("> start map (" in line for line in robot.lines) > begun)
    robot.wait(lambda: {c.service: c.id for c in robot.containers()} == before and failed(robot, "map"))


@pytest.mark.slow
def test_apply_without_a_rorg_leaves_a_long_bake_to_the_next_one(tmp_path):
    tree, where = tmp_path / "tree", {"RORG_STATE_DIR": str(tmp_path / "state"), "RORG_ENGINE": "process"}
    robot = RealRobot(tmp_path, "process", None)
    try:
        write_tree(tree, {"nav": WELL})
        apply = ("apply", str(tree), "--yes", "--wait", "--timeout")
        assert rorg(*apply, "60s", **where).returncode == 0
        before = robot.container("nav").id
        write_tree(tree, {"nav": changed(1, update={"bake": "1h"})})
        assert "still being watched: nav" in rorg(*apply, "8s", **where).stderr
        assert running(robot, "nav").id != before
        assert before in {c.id for c in robot.containers()}
    finally:
        robot.close()
