"""Holds what tests/unit promises: none of its tests starts a process, and none needs a Docker engine."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent
PROCESSES = {"subprocess.Popen", "os.fork", "os.forkpty", "os.posix_spawn", "os.exec", "os.spawn", "os.system"}
"""Audit events of whoever starts a process."""
ENGINES = {"dockerd", "docker_robot"}
"""Fixtures that need a Docker engine."""
_running: list[str] = []
_started: list[str] = []


class StartsAProcess(BaseException):
    """Unlike an Exception, it gets through code under test that copes with failures."""


def _watch(event: str, arguments: tuple[object, ...]) -> None:
    if _running and event in PROCESSES:
        _started.append(f"{event} {arguments[:2]}")
        raise StartsAProcess(f"{_running[-1]} starts a process: move it to tests/process")


sys.addaudithook(_watch)  # Python has no way to remove one


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Watches a test with its fixtures. pytest calls this hook for the tests of all folders."""
    _started.clear()
    if item.path.is_relative_to(FOLDER):
        _running.append(item.nodeid)
    try:
        return (yield)
    finally:
        _running.clear()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(nextitem: pytest.Item | None) -> Iterator[None]:
    """The last test takes down what the tests of other folders set up, such as an engine."""
    if nextitem is None:
        _running.clear()
    return (yield)


@pytest.fixture(autouse=True)
def processes() -> Iterator[list[str]]:
    """What a test starts, which is nothing. A thread may try as well, whose exception nobody sees."""
    yield _started
    assert not _started, "starts a process: move it to tests/process"


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Refuses a test that needs a Docker engine, also if such tests are not chosen."""
    for item in items:
        if item.path.is_relative_to(FOLDER):
            needs = ENGINES & set(getattr(item, "fixturenames", ()))
            if needs or item.get_closest_marker("docker"):
                raise pytest.UsageError(f"{item.nodeid} needs a Docker engine: move it to tests/docker")
