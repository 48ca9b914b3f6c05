"""The cache of what the engine says: answers that overtake each other."""

from __future__ import annotations

import os
import signal
import subprocess
import threading

import psutil
from common import wait_for

from rorg.core.observed import Container
from rorg.engines.observe import Observer
from rorg.engines.process.table import MARK, Run, await_program, boot_id, is_same, stat

RUNNING, ENDED = (Container("c1", "camera", "camera", state) for state in ("running", "exited"))


class SlowAnswers:
    """An engine whose first answer to each question arrives only when it is let go."""

    name = "slow"

    def __init__(self) -> None:
        self.state = RUNNING
        self.asked, self.go = threading.Event(), threading.Event()
        self.first = True

    def inspect(self, container: str) -> Container:
        found, slow = self.state, self.first
        self.first = False
        if slow:
            self.asked.set()
            assert self.go.wait(60)
        return found

    def list(self, known=None) -> list[Container]:
        return [self.inspect("c1")]


def overtaken(slow_question: str) -> str:
    """State in the cache after a slow answer arrived later than the one to a younger question."""
    engine = SlowAnswers()
    observer = Observer(engine, lambda: None, lambda: 60.0)
    call = {"refresh": lambda: observer.refresh("c1"), "sync": observer.sync}[slow_question]
    asking = threading.Thread(target=call)
    asking.start()
    wait_for(engine.asked.is_set)
    engine.state = ENDED
    observer.refresh("c1")
    engine.go.set()
    asking.join(60)
    return observer.snapshot().containers[0].state


def test_an_older_look_at_a_container_does_not_win():
    assert overtaken("refresh") == "exited"


def test_an_older_list_does_not_win():
    assert overtaken("sync") == "exited"


SHELL = 'trap : INT; "$@"; true'


def test_a_program_that_just_began_is_known_as_ours_and_hears_signals():
    """Looked at as soon as it can be, one of five is amid its exec and has no environment; signals in the first
    milliseconds meet the shell's handlers; and a shell whose child is paused before its exec can not be paused."""
    for _ in range(60):
        words = ["/bin/sh", "-c", SHELL, "rorg", "sleep", "60"]
        child = subprocess.Popen(words, env={**os.environ, MARK: "ours"}, start_new_session=True)
        await_program(child, "ours")
        facts = stat(child.pid)
        assert facts
        assert is_same(Run(child.pid, facts.started, boot_id(), "ours"))
        os.killpg(child.pid, signal.SIGSTOP)
        wait_for(lambda pid=child.pid: stat(pid).state == "T", 10)
        (program,) = psutil.Process(child.pid).children()
        program.send_signal(signal.SIGINT)
        os.killpg(child.pid, signal.SIGCONT)
        child.wait(30)
