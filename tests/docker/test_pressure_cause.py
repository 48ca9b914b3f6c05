"""Measures under pressure are taken only where they help, and the reason says what caused it."""

from __future__ import annotations

import subprocess
import sys
import time

import pytest
from common import wait_for
from pressed_robots import BURN, GIB, POLICY, service
from robots import RealRobot, VirtualRobot
from shed import shed

OTHERS = "by programs outside rorg"


@pytest.fixture
def robot(tmp_path):
    return VirtualRobot(tmp_path)


def pressure(robot):
    return robot.sim.memory.pressure


def run_for(robot, seconds: float) -> None:
    end = robot.now() + seconds
    robot.sim.at(end, lambda: None)
    robot.wait(lambda: robot.now() >= end, seconds + 10)


def test_what_uses_nothing_stays_while_others_cause_the_load_on_docker(dockerd, slice_of_its_own, tmp_path):
    robot = RealRobot(tmp_path, "docker", dockerd.host, look=slice_of_its_own.look)
    own = {"container": {"cgroup_parent": slice_of_its_own.name}}
    burner = None
    try:
        robot.declare(
            {"base": {"priority": 90, **own}, "idle": {"priority": 10, **own}},
            policies={
                "policy": {
                    "budget": {"cpu": 0.4},
                    "pressure": {"step": "200ms", "calm": "1s", "memory_some": 100, "admit": 0},
                }
            },
        )
        robot.request("base", "idle")
        robot.wait(lambda: robot.active() == {"base", "idle"})
        before = robot.engine.api().inspect_container("idle")
        burner = subprocess.Popen([sys.executable, "-c", "while True: pass"])
        slice_of_its_own.add(burner.pid)
        robot.wait(lambda: OTHERS in robot.status()["pressure"]["reason"])
        began = time.monotonic()
        wait_for(lambda: time.monotonic() > began + 2.5)
        assert robot.status()["pressure"]["measures"] == []
        assert robot.status()["pressure"]["shed"] == {}
        after = robot.engine.api().inspect_container("idle")
        assert (after["Id"], after["State"]["StartedAt"], after["State"]["Running"]) == (
            before["Id"],
            before["State"]["StartedAt"],
            True,
        )
        assert not after["HostConfig"]["CpuShares"]
        assert any("nothing that rorg runs would help" in line for line in robot.lines)
    finally:
        if burner:
            burner.kill()
            burner.wait()
        robot.close()


def test_who_causes_it_goes_though_another_matters_less_on_docker(dockerd, slice_of_its_own, tmp_path):
    robot = RealRobot(tmp_path, "docker", dockerd.host, look=slice_of_its_own.look)
    own = {"cgroup_parent": slice_of_its_own.name}
    burn = {"command": BURN, "container": {"environment": {"BURN": "0.9", "HOARD": "1"}, **own}}
    try:
        limits = {"step": "200ms", "calm": "60s", "memory_some": 100}
        robot.declare(
            {
                "base": {"priority": 90, "container": own},
                "idle": {"priority": 10, "container": own},
                "burner": {"priority": 20, **burn},
            },
            policies={"policy": {"budget": {"cpu": 0.4}, "pressure": limits}},
        )
        robot.request("base", "idle")
        robot.wait(lambda: robot.active() == {"base", "idle"})
        before = robot.container("idle").incarnation
        robot.request("burner", id="more", priority=70)
        robot.wait(lambda: "burner" in robot.active())
        robot.wait(lambda: "burner" in robot.status()["pressure"]["shed"])
        assert "by burner" in robot.status()["pressure"]["shed"]["burner"]
        assert robot.container("idle").incarnation == before
        assert "idle" in robot.active()
    finally:
        robot.close()


def test_what_is_short_decides_which_measure_helps(robot):
    robot.declare(
        {
            "base": service(0.5, "1Gi", 90),
            "old": service(0.0, "1536Mi", 30, idle={"action": "pause"}),
            "log": service(0.7, "1Mi", 20),
            "map": service(0.0, "1Gi", 10),
        },
        policies=POLICY,
    )
    robot.request("base", "log", "map")
    robot.request("old", id="old")
    robot.wait(lambda: len(robot.active()) == 4)
    robot.release("old")
    robot.wait(lambda: robot.states()["old"] == "paused")
    robot.sim.extra = (1.2, 0)
    robot.wait(lambda: shed(robot) == ["log"])
    run_for(robot, 5)
    assert robot.states()["old"] == "paused", "stopping it frees no CPU"
    assert "map" in robot.active()
    assert OTHERS in robot.waits("log")
    assert "0.7 by log" in robot.waits("log")


def test_memory_is_not_won_by_lowering_shares(robot):
    robot.declare(
        {"base": service(0.5, "1Gi", 90), "log": service(0.5, "1Mi", 20), "map": service(0.1, "1Gi", 30)},
        policies=POLICY,
    )
    robot.request("base", "log", "map")
    robot.wait(lambda: len(robot.active()) == 3)
    robot.sim.extra = (0.0, 3 * GIB)
    robot.wait(lambda: shed(robot) == ["map"])
    assert "log" in robot.active()
    assert "cpu_shares" not in robot.container("log").live
    robot.sim.extra = (0.0, 0)
    robot.wait(lambda: robot.active() == {"base", "log", "map"} and not pressure(robot).engaged)


def test_a_load_that_nobody_of_ours_makes_less_changes_nothing(robot):
    robot.declare(
        {"base": service(0.01, "1Mi", 90), "log": service(0.01, "1Mi", 20)},
        policies={"policy": {**POLICY["policy"], "pressure": {**POLICY["policy"]["pressure"], "admit": 0}}},
    )
    robot.request("base", "log")
    robot.wait(lambda: len(robot.active()) == 2)
    robot.sim.extra = (4.0, 8 * GIB)
    run_for(robot, 60)
    assert robot.active() == {"base", "log"}
    assert not pressure(robot).engaged
    assert f"4.0 {OTHERS}" in pressure(robot).reason
    robot.sim.extra = (0.0, 0)
    robot.wait(lambda: pressure(robot).reason == "")
