"""An engine that is frozen, or does not answer."""

from __future__ import annotations

import signal
from contextlib import contextmanager
from pathlib import Path

import pytest
from common import wait_for


@contextmanager
def frozen(dockerd):
    """While the block runs the engine does nothing, and its sockets still take connections."""
    if not hasattr(dockerd, "folder"):
        pytest.skip("somebody else runs this engine")
    dockerd.process.send_signal(signal.SIGSTOP)
    threads = Path(f"/proc/{dockerd.process.pid}/task")
    # The signal takes a moment to reach all threads; until then the engine may answer.
    wait_for(lambda: all(stat.read_text().rpartition(")")[2].split()[0] == "T" for stat in threads.glob("*/stat")))
    try:
        yield
    finally:
        dockerd.process.send_signal(signal.SIGCONT)


def silent(robot) -> bool:
    return bool(robot.client().call("GET", "/v1/engine")["silent_since"])
