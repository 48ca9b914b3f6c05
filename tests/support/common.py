"""What most tests use: where things are, waiting with a deadline, ports, and what to do without an engine.

Tests and helpers import it; conftest.py has the fixtures. It imports nothing heavy, because programs that tests start
begin with it too."""

from __future__ import annotations

import fcntl
import select
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

ROOT = Path(__file__).parents[2]
"""The top of the repository."""
TESTS = ROOT / "tests"
CASES, SUPPORT, ASSURANCE = TESTS / "cases", TESTS / "support", TESTS / "assurance"
BASE_IMAGE = "rorg-base"


@contextmanager
def alone_on_the_machine(what: str) -> Iterator[None]:
    """Other runs of these tests that need it wait: a port that cannot be chosen, and the like."""
    with Path(f"/tmp/rorg-tests-{what}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def wait_for(condition, seconds: float = 60.0, what: str = "the condition"):
    """Polls a condition with a deadline; returns its first true value."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        value = condition()
        if value:
            return value
        time.sleep(0.005)
    raise AssertionError(f"not within {seconds} s: {what}")


def readable(descriptor: int, seconds: float = 0.0) -> bool:
    """Whether something can be read within this time, the end included. Unlike select, poll takes any descriptor."""
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    return bool(poll.poll(seconds * 1000))


def free_port() -> int:
    """A TCP port that nobody uses now."""
    with socket.create_server(("127.0.0.1", 0)) as found:
        return found.getsockname()[1]


def no_docker(reason: str) -> NoReturn:
    """Skip a test without an engine, or fail it, as without any other tool."""
    from tools import no_tool

    no_tool(f"NO DOCKER ENGINE: {reason}")


def run_in_container(host: str, image: str, script: str, binds: list[str]) -> None:
    """Runs a script of bash to its end; fails with what it says where that is not well."""
    import docker

    api = docker.APIClient(host, version="auto")
    options = api.create_host_config(network_mode="host", binds=binds)
    made = api.create_container(image, ["bash", "-c", script], host_config=options)["Id"]
    api.start(made)
    code = api.wait(made)["StatusCode"]
    said = api.logs(made).decode()
    api.remove_container(made)
    assert code == 0, said
