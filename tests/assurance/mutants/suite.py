"""The tests that mutants must pass, each in a process forked from one that has imported them all."""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import os
import pickle
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

import hypothesis
import pytest
from _pytest.tmpdir import tmppath_result_key
from common import ASSURANCE, ROOT, SUPPORT, TESTS
from mutants.plant import FOLDER

OUT = ROOT / ".mutants"
MEMORY = 4 << 30
"""Bytes that a test may take, so that a mutant that fills lists without end fails."""
WORLDLY = "subprocess.Popen", "os.posix_spawn", "os.fork", "_thread.start_new_thread", "socket.bind"
"""Audit events of a test that does more than compute. Its outcome may depend on the machine, and it takes long."""
TIMED_OUT = signal.SIGPROF, signal.SIGALRM
FAILS, LONG = "fails without a mutant", "takes long"
Tell = Callable[[object], NoReturn]
"""Ends a process with its result."""
Lines = frozenset[tuple[str, int]]
"""Files of core, and lines in them."""


@dataclass(frozen=True)
class Traced:
    """What a test did without a mutant: its CPU seconds while traced, and the lines it executed. `unfit` is why mutants
    are not tried with it."""

    seconds: float = 0.0
    lines: Lines = frozenset()
    unfit: str = ""


@dataclass
class Suite:
    """A pytest plugin that hands the collected tests to `work` instead of running them."""

    work: Callable[[Suite], None]
    items: dict[str, pytest.Item] = field(default_factory=dict)
    traced: dict[str, Traced] = field(default_factory=dict)

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        self.items = {item.nodeid: item for item in session.items if needs_nothing(item)}
        self.work(self)
        return True

    def trace(self, most: float, say: Callable[[str], None]) -> None:
        """Find out which lines each test executes. Tests that fail, start something, or take long are left out."""
        known, left_out = _Known(), Counter[str]()
        for name, item in self.items.items():
            found = known.get(item)
            if found is None:
                found, _ = in_child(lambda tell, item=item: _traced(item, tell), most)
                found = found or Traced(unfit=LONG)
                known.put(item, found)
            if found.unfit:
                left_out[found.unfit] += 1
                if found.unfit in (FAILS, LONG):
                    say(f"left out: {name}: {found.unfit}")
            else:
                self.traced[name] = found
        known.write()
        say(f"{len(self.traced)} tests; left out: {dict(left_out)}")

    def first_failure(self, names: Collection[str]) -> str:
        """Run tests until one fails, in this process; return it, or nothing."""
        for name in names:
            _limit_time(1.0 + 4 * self.traced[name].seconds)
            if not passes(self.items[name]):
                return name
        return ""


def needs_nothing(item: pytest.Item) -> bool:
    """Whether a test needs no engine but the simulated one."""
    fixtures = set(getattr(item, "fixturenames", ()))
    engine = getattr(getattr(item, "callspec", None), "params", {}).get("robot", "sim")
    return engine == "sim" and not fixtures & {"real_robot", "docker_robot", "dockerd", "process_engine"}


def texts_of(item: pytest.Item) -> str:
    """The text of a test, and of the file that it is about."""
    files = [v for v in getattr(getattr(item, "callspec", None), "params", {}).values() if isinstance(v, Path)]
    found = [f.read_text(errors="replace") for f in files if f.is_file()]
    return "\n".join([inspect.getsource(item.function), item.name, *found])  # type: ignore[attr-defined]


def run(files: list[str], work: Callable[[Suite], None]) -> int:
    """Collect tests and let `work` have them. Random examples are the same in every run."""
    hypothesis.settings.register_profile(
        "mutants", database=None, derandomize=True, deadline=None, suppress_health_check=list(hypothesis.HealthCheck)
    )
    options = ["-qq", "-s", "--assert=plain", "-p", "no:logging", "-p", "no:faulthandler", "--rootdir", str(ROOT)]
    os.environ.setdefault("RORG_TEST_EXAMPLES", "6")
    return int(pytest.main([*options, "--hypothesis-profile=mutants", "--hypothesis-seed=1", *files], [Suite(work)]))


def passes(item: pytest.Item) -> bool:
    """Run a test with its fixtures, without a report."""
    item._initrequest()
    item.stash[tmppath_result_key] = {"call": True}
    passed = _goes_well(item.ihook.pytest_runtest_setup, item=item)
    passed = passed and _goes_well(item.ihook.pytest_runtest_call, item=item)
    return _goes_well(item.ihook.pytest_runtest_teardown, item=item, nextitem=None) and passed


def _goes_well(hook: Callable[..., object], **arguments: object) -> bool:
    try:
        hook(**arguments)
    except pytest.skip.Exception:
        return True
    except BaseException:  # also the end of a program, and pytest's own
        return False
    return True


def in_child(work: Callable[[Tell], object], seconds: float) -> tuple[Any, int]:
    """What `work` returns or tells in a fork of this process, and the signal that ended it before."""
    folder = Path(tempfile.mkdtemp(prefix="rorg-mutant.", dir="/dev/shm" if os.path.isdir("/dev/shm") else None))
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        try:
            os.setpgid(0, 0)
            os.environ["TMPDIR"] = tempfile.tempdir = str(folder)
            nothing = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nothing, 1)
            os.dup2(nothing, 2)
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
            for number in TIMED_OUT:
                signal.signal(number, signal.SIG_DFL)
            _limit_time(seconds)
            tell = partial(_tell, writing)
            tell(work(tell))
        finally:
            os._exit(0)
    os.close(writing)
    with open(reading, "rb") as source:
        said = source.read()
    _, status = os.waitpid(child, 0)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)  # what a test has started and left behind
    shutil.rmtree(folder, ignore_errors=True)
    return (pickle.loads(said) if said else None), os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0


def _tell(descriptor: int, result: object) -> NoReturn:
    """End a child with this result."""
    with open(descriptor, "wb") as out:
        out.write(pickle.dumps(result))
    os._exit(0)


def _limit_time(seconds: float) -> None:
    """End this process after so many seconds of CPU, or twenty times as many of the clock."""
    signal.setitimer(signal.ITIMER_PROF, seconds)
    signal.setitimer(signal.ITIMER_REAL, 20 * seconds)


def _traced(item: pytest.Item, tell: Tell) -> Traced:
    lines, folder = set[tuple[str, int]](), str(FOLDER) + os.sep

    def call(frame: FrameType, event: str, argument: object) -> Any:
        file = frame.f_code.co_filename
        if not file.startswith(folder):
            return None
        file = file[len(folder) :]

        def line(frame: FrameType, event: str, argument: object) -> Any:
            if event == "line":
                lines.add((file, frame.f_lineno))
            return line

        return line

    began = time.process_time()
    sys.addaudithook(lambda event, _: tell(Traced(unfit=event)) if event in WORLDLY else None)
    sys.settrace(call)
    passed = passes(item)
    sys.settrace(None)
    return Traced(time.process_time() - began, frozenset(lines), "" if passed else FAILS)


class _Known:
    """What was traced before, of tests and code that are still the same: tracing takes minutes."""

    def __init__(self) -> None:
        sources = [
            *ROOT.glob("rorg/**/*.py"),
            *SUPPORT.glob("*.py"),
            *ASSURANCE.glob("bounded/*.py"),
            TESTS / "conftest.py",
        ]
        helpers = [p for p in sources if not p.name.startswith("test_")]
        self.common = hashlib.sha256(b"".join(p.read_bytes() for p in sorted(helpers))).hexdigest()
        self.path = OUT / "traced"
        self.found: dict[str, Traced] = {}
        if self.path.exists():
            self.found = pickle.loads(self.path.read_bytes())

    def _key(self, item: pytest.Item) -> str:
        values = getattr(getattr(item, "callspec", None), "params", {}).values()
        files = [item.path, *(v for v in values if isinstance(v, Path) and v.is_file())]
        content = b"".join(f.read_bytes() for f in files)
        return hashlib.sha256(f"{self.common} {item.nodeid}".encode() + content).hexdigest()

    def get(self, item: pytest.Item) -> Traced | None:
        return self.found.get(self._key(item))

    def put(self, item: pytest.Item, traced: Traced) -> None:
        if traced.unfit != FAILS:
            self.found[self._key(item)] = traced

    def write(self) -> None:
        OUT.mkdir(exist_ok=True)
        self.path.write_bytes(pickle.dumps(self.found))
