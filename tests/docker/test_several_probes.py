"""Probes of several parts on real programs."""

from __future__ import annotations

import socket

import pytest
from common import free_port, wait_for
from health_server import SERVER, health, server, tell
from robots import RealRobot


@pytest.mark.slow
def test_what_needs_it_waits_until_all_parts_hold(real_robot, tmp_path):
    port = free_port()
    spec = server(tmp_path, real_robot)
    written = spec["container"]["environment"]["READY_FILE"]
    parts = [{"file": written, "interval": "100ms"}, {"tcp": port}]
    real_robot.declare(
        {"server": {**spec, "ready": {"all": parts, "failures": 2}}, "client": {"needs": ["server"]}},
    )
    real_robot.request("client")
    real_robot.wait(
        lambda: f"file {written}" in real_robot.waits("client") and f":{port}" in real_robot.waits("client")
    )
    tell(real_robot, "server", "SIGUSR1")
    real_robot.wait(lambda: f":{port}" in (why := real_robot.waits("client")) and written not in why)
    assert "client" not in real_robot.active()
    with socket.create_server(("127.0.0.1", port)):
        real_robot.wait(lambda: "client" in real_robot.active())
        real_robot.wait(lambda: health(real_robot, "server") == "Healthy")
    real_robot.wait(lambda: health(real_robot, "server") != "Healthy")
    assert f":{port}" in real_robot.status()["services"]["server"]["message"]


def test_a_program_is_restarted_when_one_part_of_its_life_fails(real_robot, tmp_path):
    spec = server(tmp_path, real_robot, always_on=True, command=SERVER)
    alive = spec["container"]["environment"]["ALIVE_FILE"]
    with socket.create_server(("127.0.0.1", 0)) as listener:
        parts = [{"tcp": listener.getsockname()[1]}, {"file": alive}]
        real_robot.declare({"server": {**spec, "live": {"all": parts, "interval": "500ms", "failures": 2}}})
        real_robot.wait(lambda: "server" in real_robot.active())
        real_robot.settle()
        before = real_robot.container("server").incarnation
        tell(real_robot, "server", "SIGUSR2")
        real_robot.wait(
            lambda: "server" in real_robot.active() and real_robot.container("server").incarnation != before
        )
    assert any("did not answer" in line and alive in line for line in real_robot.log())


def test_why_names_the_parts_that_do_not_hold(tmp_path):
    port = free_port()
    robot = RealRobot(tmp_path, "process", None, with_server=True)
    try:
        with socket.create_server(("127.0.0.1", 0)) as listener:
            parts = [{"tcp": listener.getsockname()[1]}, {"tcp": port}]
            robot.declare({"server": {"always_on": True, "ready": {"all": parts}}})
            refused = [f"`ready` (all) fails: tcp 127.0.0.1:{port}: Connection refused"]
            wait_for(lambda: robot.client().why("server")[0]["waits"] == refused)
    finally:
        robot.close()
