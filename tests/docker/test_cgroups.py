"""What a container uses is read from its control groups, never from those of the machine."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from common import wait_for

from rorg.host.cgroups import container_usage


def state(pid: int) -> str:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]


def test_a_program_that_has_just_ended_uses_nothing(slice_of_its_own):
    program = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    slice_of_its_own.add(program.pid)
    try:
        assert container_usage(program.pid) is not None
    finally:
        program.kill()
    # Until somebody waits for it, it is there: on v1 in the root of all control groups, on v2 in its own.
    wait_for(lambda: state(program.pid) == "Z", 30, "its end")
    used = container_usage(program.pid)
    assert used is None if slice_of_its_own.v1 else used is not None and used[1] == 0
    program.communicate()
