"""Docker 20.10 is replaced by Docker 26 under a running robot: rorg notices the new release, speaks its API, and knows
its containers again."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from common import no_docker, wait_for
from dockerd import Dockerd, NewerDocker, import_base
from robots import RealRobot

pytestmark = pytest.mark.docker

LIVE = ("--live-restore",)


@pytest.fixture
def folder():
    """Short, because of the socket in it."""
    if why := Dockerd.missing() or NewerDocker.missing():
        if why.startswith("no Docker 26"):
            pytest.skip(f"{why}; .ci/engines brings it")
        no_docker(why)
    return Path(subprocess.check_output(["mktemp", "-d", "/tmp/rorg-dockerd.XXXXXX"], text=True).strip())


@pytest.mark.parametrize("live", [True, False], ids=["live-restore", "stopped"])
def test_a_robot_goes_on_after_its_docker_was_upgraded(folder, live, tmp_path):
    old = Dockerd(folder)
    new = NewerDocker.__new__(NewerDocker)
    new.folder, new.host, new.process, new.addresses = old.folder, old.host, None, old.addresses
    old.options = new.options = LIVE if live else ()
    old.start()
    try:
        import_base(old.host)
        upgraded(RealRobot(tmp_path, "docker", old.host), old, new, live)
    finally:
        old.stop()
        new.stop()
        Dockerd.clean(folder)


def upgraded(robot: RealRobot, old: Dockerd, new: Dockerd, live: bool) -> None:
    robot.declare({"base": {"always_on": True}, "camera": {"idle": {"action": "pause"}}})
    try:
        robot.wait(lambda: robot.active() == {"base"})
        robot.request("camera")
        robot.wait(lambda: robot.active() == {"base", "camera"})
        assert robot.engine.client.release.version.startswith("20.10")
        before = {c.service: (c.id, c.incarnation) for c in robot.containers()}
        old.stop()
        new.start()
        wait_for(lambda: robot.engine.client.release.version.startswith("26"), 60, "rorg to notice the release")
        assert robot.engine.client.release.api == (1, 45)
        robot.wait(lambda: robot.active() == {"base", "camera"})
        robot.settle()
        after = {c.service: (c.id, c.incarnation) for c in robot.containers()}
        assert {name: pair[0] for name, pair in after.items()} == {name: pair[0] for name, pair in before.items()}
        assert (after == before) is live, "programs go on with live-restore, and begin again without"
        assert not [line for line in robot.log() if "bug:" in line]
    finally:
        robot.close()
