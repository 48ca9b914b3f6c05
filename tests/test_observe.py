"""The cache of what the engine says: answers that overtake each other."""

from __future__ import annotations

import subprocess
import threading

from conftest import wait_for

from rorg.core.observed import Container
from rorg.engines.observe import Observer
from rorg.engines.process.table import MARK, await_mark, boot_id, is_same, stat

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

    def list(self) -> list[Container]:
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


def test_a_program_that_just_began_is_known_as_ours():
    """Of five that are looked at as soon as they can be, one is in the middle of exec, where it has no environment."""
    for _ in range(100):
        child = subprocess.Popen(["/bin/sh", "-c", "read line; true"], stdin=subprocess.PIPE, env={MARK: "ours"})
        await_mark(child, "ours")
        facts = stat(child.pid)
        assert facts and is_same(child.pid, facts[2], boot_id(), "ours")
        child.communicate()
