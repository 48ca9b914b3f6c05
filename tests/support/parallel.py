"""One run of the tests by several processes, the workers of pytest-xdist: what they share, how they end, and what the
summary adds up. The controller is the pytest that somebody calls; it runs no tests itself if it has workers."""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
import time
from collections import Counter
from pathlib import Path, PurePosixPath

import pytest

SHARED = "RORG_TEST_SHARED"
"""Names the folder where one worker leaves what the others need too, such as a wheel."""
SECONDS_TO_END = 60.0
"""In which interrupted workers stop their engines. Left to itself, xdist kills them after 10."""


def is_worker(config: pytest.Config) -> bool:
    return hasattr(config, "workerinput")


class Workers:
    """The controller's plugin. It makes the shared folder, gives all workers one seed, and ends them in order."""

    def __init__(self, seed: str) -> None:
        self.seed = seed
        self.nodes: list = []
        self.crashed = False
        """Then tests are missing that the worker was to run."""
        self.made = "" if os.environ.get(SHARED) else tempfile.mkdtemp(prefix="rorg-tests-shared-")
        if self.made:
            os.environ[SHARED] = self.made  # the workers inherit it

    @pytest.hookimpl(optionalhook=True)
    def pytest_configure_node(self, node) -> None:
        node.workerinput["rorg_seed"] = self.seed
        self.nodes.append(node)

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node, error) -> None:
        self.crashed = self.crashed or bool(error)

    def pytest_keyboard_interrupt(self) -> None:
        """Tells the workers, which a signal to this process alone does not reach, and waits for their fixtures."""
        for process in self._running():
            process.send_signal(signal.SIGTERM)
        deadline = time.monotonic() + SECONDS_TO_END
        while self._running() and time.monotonic() < deadline:
            time.sleep(0.05)

    def _running(self) -> list:
        """The processes of workers that have not finished their session."""
        busy = [node.gateway._io.popen for node in self.nodes if not hasattr(node, "workeroutput")]
        return [process for process in busy if process.poll() is None]

    def pytest_unconfigure(self) -> None:
        if self.made:
            del os.environ[SHARED]
            shutil.rmtree(self.made, ignore_errors=True)


def all_ran(config: pytest.Config) -> bool:
    """No worker ended before its tests had run."""
    workers = config.pluginmanager.get_plugin(Workers.__name__)
    return workers is None or not workers.crashed


def end_at_signals(numbers: tuple[int, ...]) -> None:
    """The first of these signals interrupts the session, so that its engines end. Further ones change nothing, but
    programs that start meanwhile do not inherit that."""

    def end(number: int, frame: object) -> None:
        for each in numbers:
            signal.signal(each, lambda *_: None)
        raise KeyboardInterrupt(signal.Signals(number).name)

    for number in numbers:
        signal.signal(number, end)


class Folders:
    """Seconds and tests by folder. Seconds of workers add up, so they exceed the time of the run."""

    def __init__(self) -> None:
        self.seconds: Counter[str] = Counter()
        self.tests: Counter[str] = Counter()

    def count(self, report: pytest.TestReport) -> None:
        folder = str(PurePosixPath(report.nodeid.partition("::")[0]).parent)
        self.seconds[folder] += report.duration
        self.tests[folder] += report.when == "setup"

    def lines(self) -> list[str]:
        """A line for each folder, the slowest first."""
        width = max(map(len, self.seconds), default=0)
        return [
            f"{folder:{width}} {seconds:8.1f} s {self.tests[folder]:6} tests"
            for folder, seconds in self.seconds.most_common()
        ]


def write_failed(path: Path, reports: list[pytest.TestReport]) -> None:
    """Appends a line for each failed test: what failed, a tab, the test."""
    causes = {report.nodeid: _cause(report) for report in reports}
    with path.open("a") as file:
        file.writelines(f"{cause}\t{test}\n" for test, cause in sorted(causes.items()))


def _cause(report: pytest.TestReport) -> str:
    """What counts as one failure: a test, or a fixture that several could not be set up with."""
    crash = getattr(report.longrepr, "reprcrash", None)
    shared = report.when == "setup" and crash is not None
    return f"{crash.path}:{crash.lineno}" if shared else report.nodeid
