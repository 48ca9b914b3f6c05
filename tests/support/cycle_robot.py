"""A robot for the programs of cycles.py."""

from __future__ import annotations

import pytest
from common import ROOT, wait_for
from cycles import SERVICES, commands, compile_cpp
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
