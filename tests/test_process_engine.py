"""The process engine by itself: commands beside a service, and what its programs print."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest
from conftest import wait_for

from rorg.core.observed import LABEL_OWNER, LABEL_SERVICE
from rorg.engines.process.engine import ProcessEngine


@pytest.fixture
def engine(tmp_path):
    found = ProcessEngine("me", tmp_path / "process")
    yield found
    for container in found.list():
        found.stop(container.id, "SIGKILL", 5.0)
        found.remove(container.id)


def start(engine, *command: str) -> str:
    made = engine.create("x", {"image": "x", "command": command}, {LABEL_OWNER: "me", LABEL_SERVICE: "x"})
    engine.start(made)
    return made


def test_a_command_that_takes_too_long_is_ended_with_all_that_it_began(engine):
    container = start(engine, "sleep", "600")
    began = time.monotonic()
    code, output = engine.exec(container, ["sh", "-c", "sleep 601 & echo $!; wait"], 0.5)
    assert time.monotonic() - began < 5
    child, said = output.splitlines()
    assert (code, said) == (124, b"no end within 0.5 s")
    wait_for(lambda: _state(int(child)) in "ZX", what="the child of the command to end")
    assert engine.inspect(container).state == "running"


def _state(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return "X"


def test_exit_codes_and_output_of_commands(engine):
    container = start(engine, "sleep", "600")
    assert engine.exec(container, ["sh", "-c", "echo out; echo err >&2; exit 3"], 5.0) == (3, b"out\nerr\n")
    assert engine.exec(container, ["no-such-program"], 5.0)[0] == 127
    assert os.listdir(engine.records.folder(container)) != []
