"""`rorg doctor` with a running rorg, and where rorg cannot work."""

from __future__ import annotations

import json
import os

from commands import rorg
from robots import RealRobot

from rorg.core.doctor import ERROR, OK, WARNING
from rorg.host import installation as host


def checks(code: int = 0, **environment: str) -> dict[str, str]:
    found = json.loads(rorg("doctor", "-o", "json", code=code, **environment).stdout)
    return {c["check"]: c["status"] for c in found}


def test_doctor_sees_a_running_rorg_and_one_that_is_gone(tmp_path):
    robot = RealRobot(tmp_path, "process", None, with_server=True)
    environment = {"RORG_STATE_DIR": str(robot.state.path), "RORG_ENGINE": "process"}
    try:
        robot.declare({"arm": {}})
        robot.settle()
        found = checks(**environment)
        assert {found[n] for n in ("rorg", "engine", "state-directory", "journal")} == {OK}
    finally:
        robot.close()
    assert checks(**environment)["rorg"] == WARNING


def test_doctor_exits_4_where_rorg_cannot_work(tmp_path):
    environment = {"RORG_STATE_DIR": str(tmp_path), "DOCKER_HOST": f"unix://{tmp_path}/nobody.sock"}
    assert checks(4, **environment)["engine"] == ERROR
    shown = rorg("doctor", code=4, **environment).stdout
    assert "does not answer" in shown
    assert os.linesep in shown


def test_the_kernel_knows_whether_its_clock_is_kept_right():
    assert host.clock_synchronized() in (True, False)
    assert host.open_files() > 0
    assert host.git_version().startswith("git version")
