"""0 times told ready and found something else: the short version. tests/bench/test_cycles.py plays thousands."""

from __future__ import annotations

import pytest
from conftest import ROOT, wait_for
from cycles import SERVICES, Restarts, commands, compile_cpp, cycle
from robots import Daemon, write_tree


@pytest.fixture(scope="session")
def programs(once):
    return commands(once("cycle", lambda folder: compile_cpp(folder, ROOT / "clients/cpp/include")) / "cycle")


@pytest.fixture
def daemon(real_robot):
    found = Daemon(real_robot)
    write_tree(real_robot.tree, SERVICES)
    found.start()
    wait_for(found.settled, 60)
    yield found
    found.kill()


def test_programs_are_told_the_truth(daemon, programs):
    result = cycle(daemon, programs, 20 if daemon.robot.kind == "docker" else 60)
    assert not result.wrong
    assert not result.errors


def test_programs_see_no_more_than_a_longer_wait_while_rorg_is_stopped_and_killed(daemon, programs):
    restarts = Restarts(daemon, every=25)
    result = cycle(daemon, programs, 20 if daemon.robot.kind == "docker" else 40, restarts)
    assert not result.wrong
    assert not result.errors
    assert restarts.count >= 2
