"""What it costs to bring up many services, and to hold them: CPU seconds of rorg's own, and memory."""

from __future__ import annotations

import re
import time
from pathlib import Path

import psutil
import pytest
from conftest import wait_for
from robots import Daemon, RealRobot, write_tree

from rorg.core.decide import decide
from rorg.manifest.load import load_or_raise
from rorg.tools.sim.robot import SimRobot


def chains(count: int) -> dict[str, dict]:
    """Chains of five that need one another; whoever is last in one is always on."""
    return {f"s{n:03}": {"needs": [f"s{n - 1:03}"] if n % 5 else [], "always_on": n % 5 == 4} for n in range(count)}


@pytest.mark.parametrize(("count", "most"), [(200, 0.5), (400, 1.0), (800, 2.0)])
def test_a_cold_start_on_the_sim_engine(tmp_path, count, most):
    robot = SimRobot(load_or_raise(write_tree(tmp_path, chains(count))))
    began = time.process_time()
    robot.run(lambda r: r.decision.plan.empty and not r.memory.in_flight, 10 * count)
    used = time.process_time() - began
    assert len(robot.active()) == count
    print(f"\n{count} services from nothing, sim: {used:.2f} s CPU", end="")
    assert used <= most


def test_a_pass_over_200_unchanged_services(tmp_path):
    robot = SimRobot(load_or_raise(write_tree(tmp_path, chains(200))))
    robot.settle()
    calls, inputs = len(robot.engine.calls), robot.inputs()
    began = time.process_time()
    for _ in range(100):
        decide(inputs)
    print(f"\none pass over 200 unchanged services: {(time.process_time() - began) * 10:.2f} ms", end="")
    assert len(robot.engine.calls) == calls


@pytest.mark.parametrize("kind", ["process", "docker"])
def test_200_services_from_nothing_and_at_rest(tmp_path, request, kind):
    host = request.getfixturevalue("dockerd").host if kind == "docker" else None
    robot = RealRobot(tmp_path, kind, host)
    daemon = Daemon(robot)
    try:
        write_tree(robot.tree, chains(200))
        began = time.monotonic()
        daemon.start()
        wait_for(daemon.settled, 300)
        assert sum(s["state"] == "running" for s in daemon.status()["services"].values()) == 200
        process = psutil.Process(daemon.process.pid)
        up, used = time.monotonic() - began, sum(process.cpu_times()[:2])
        print(
            f"\n200 services from nothing, {kind}: {up:.0f} s, {used:.2f} s CPU of rorg's own (start included)", end=""
        )
        used, share = at_rest(process, 10.0)
        print(f"\nat rest over 200 services, {kind}: {used:.0f} MB PSS, {100 * share:.2f} % of a core", end="")
    finally:
        if daemon.process and daemon.process.poll() is None:
            daemon.stop()
        robot.close()


def at_rest(process: psutil.Process, seconds: float) -> tuple[float, float]:
    """(PSS in MB, cores in use), over so many seconds after a while."""
    time.sleep(3)
    before, began = sum(process.cpu_times()[:2]), time.monotonic()
    time.sleep(seconds)
    share = (sum(process.cpu_times()[:2]) - before) / (time.monotonic() - began)
    rollup = Path(f"/proc/{process.pid}/smaps_rollup").read_text()
    return int(re.search(r"^Pss:\s+(\d+)", rollup, re.MULTILINE)[1]) / 1024, share
