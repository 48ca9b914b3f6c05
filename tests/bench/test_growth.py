"""What it costs to bring up many services, and to hold them: CPU seconds of rorg's own, and memory."""

from __future__ import annotations

import gc
import math
import re
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest
from common import wait_for
from robots import Daemon, RealRobot, write_tree
from rows import Row, Table

from rorg.core.decide import decide
from rorg.core.status import Statuses
from rorg.manifest.load import load_or_raise
from rorg.model.catalog import Request
from rorg.tools.sim.robot import SimRobot


def chains(count: int) -> dict[str, dict]:
    """Chains of five that need one another; whoever is last in one is always on."""
    return {f"s{n:03}": {"needs": [f"s{n - 1:03}"] if n % 5 else [], "always_on": n % 5 == 4} for n in range(count)}


COUNTS = (50, 100, 200, 400, 800, 1600)
STEEPEST = 1.1
"""Exponent of the number of services with which a cost may grow."""


def exponent(costs: dict[int, float]) -> float:
    """The slope of the straight line through (log count, log cost), by least squares."""
    points = [(math.log(count), math.log(cost)) for count, cost in costs.items()]
    x, y = (statistics.mean(axis) for axis in zip(*points, strict=True))
    return sum((a - x) * (b - y) for a, b in points) / sum((a - x) ** 2 for a, _ in points)


def settled(robot: SimRobot) -> None:
    robot.run(lambda r: not r.memory.in_flight and r.decision.plan.empty, 50_000)


def cost(do: Callable[[], object]) -> float:
    """CPU seconds."""
    gc.collect()
    began = time.process_time()
    do()
    return time.process_time() - began


def costs_of(folder: Path, count: int) -> dict[str, float]:
    """CPU seconds of five kinds of work on a robot of so many services."""
    specs = {**chains(count - 1), "asked": {"idle": {"action": "pause", "linger": 0}}}
    robot = SimRobot(load_or_raise(write_tree(folder, specs)))
    found = {"cold start": cost(lambda: settled(robot))}
    specs["s000"] = {**specs["s000"], "container": {"environment": {"EDITION": "2"}}}
    write_tree(folder, specs)
    change = load_or_raise(folder)

    def changed() -> None:
        robot.declare(change)
        robot.step()
        settled(robot)

    def crashed() -> None:
        robot.engine.kill(next(c.id for c in robot.engine.list() if c.service == "s004"))
        robot.step()
        settled(robot)

    def requested() -> None:
        robot.document = robot.document.put(Request("bench", "developer", ("asked",)))
        robot.step()
        settled(robot)
        robot.document = robot.document.without({("developer", "bench")})
        robot.step()
        settled(robot)

    def told() -> None:
        decision = robot.decision
        statuses = Statuses(decision.situation, decision.plan, decision.holds)
        assert len([one.as_json() for one in statuses.values()]) > count

    found |= {"one change": cost(changed), "a crash": cost(crashed), "a request": cost(requested)}
    return found | {"a status": min(cost(told) for _ in range(3))}


def test_how_costs_grow_with_the_number_of_services(tmp_path):
    costs = {count: costs_of(tmp_path / str(count), count) for count in COUNTS}
    table = Table()
    for what in costs[COUNTS[0]]:
        shown = ", ".join(f"{1000 * found[what]:.1f}" for found in costs.values())
        print(f"\n{what}: {shown} ms of CPU for {COUNTS} services", end="")
        slope = exponent({count: found[what] for count, found in costs.items()})
        table.add(Row(f"{what}: exponent of the number of services, from 50 to 1,600", slope, "", STEEPEST))


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
