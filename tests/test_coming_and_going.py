"""Services that come and go, each under another name: a program that manages its own makes thousands in a year."""

from __future__ import annotations

import functools
import gc
from dataclasses import replace

import pytest
from robots import RealRobot

NAMES = [f"lab-{n}" for n in range(6)]
CALM = {"command": ["sh", "-c", "echo serving; exec sleep 1000"], "ready": {"log": "serving"}}
CRASHING = {"command": ["sh", "-c", "echo serving; sleep 0.2; exit 3"], "ready": {"log": "serving"}}


@pytest.fixture
def robot(tmp_path):
    found = RealRobot(tmp_path, "process", None, with_server=True)
    found.declare({"base": {"always_on": True}})
    yield found
    found.close()


def come(robot: RealRobot, name: str, **spec: object) -> None:
    robot.declare({"base": {"always_on": True}, name: {"may_request": ["base"], **spec}})
    robot.request(name)


def go(robot: RealRobot, name: str) -> None:
    robot.release()
    robot.declare({"base": {"always_on": True}})
    robot.change(lambda document: replace(document, removals=(name,)))
    robot.wait(lambda: name not in robot.loop.memory.progress and not robot.loop.leases.document().removals)


def kept() -> list[tuple[str, int]]:
    """Mappings and sets with a key for nearly every one of these names; caches are bounded, and left out."""
    gc.collect()
    found = []
    for one in gc.get_objects():
        if type(one) in (dict, set, frozenset) and len(one) >= len(NAMES) - 1 and one is not globals():
            named = {name for key in one for name in NAMES if isinstance(key, str | tuple) and name in str(key)}
            if len(named) >= len(NAMES) - 1 and not any(
                isinstance(holder, functools._lru_cache_wrapper) for holder in gc.get_referrers(one)
            ):
                found.append((", ".join(sorted(map(str, one))[:8]), len(one)))
    return found


def test_what_comes_and_goes_leaves_nothing_in_memory(robot):
    for number, name in enumerate(NAMES):
        if number % 2:
            come(robot, name, **CRASHING)
            robot.wait(lambda name=name: robot.loop.memory.of(name).crashes > 0)
        else:
            come(robot, name, **CALM)
            robot.wait(lambda name=name: robot.loop.memory.of(name).ready)
        robot.client(name, patience=30.0).service(name)
        go(robot, name)
    robot.settle()
    assert kept() == []


def test_one_that_is_declared_again_has_not_crashed(robot):
    for _ in range(2):
        come(robot, "lab", **CRASHING)
        robot.wait(lambda: robot.loop.memory.of("lab").crashes > 0)
        go(robot, "lab")
    told = [e["message"] for e in robot.loop.recorder.journal.since(0) if e["kind"] == "crashed"]
    assert told
    assert not [message for message in told if "unexpected exit 0" in message]
