"""What pausing a ROS 2 program does to its peers, and what it gets when it resumes: the table in docs/how-to/ros2.md.
`make ros2` prints it."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest
from common import wait_for
from ros2_programs import Hand, Ros2

SETTLE = 15.0
"""Seconds after the pause in which anything may still come."""
TOPICS = (
    "reliable, keep all",
    "reliable, keep last 10",
    "best effort, keep last 5",
    "/tf: reliable, keep last 100",
    "transient local, keep last 1",
)


class Told:
    """What a program has noted: when, about what, which value."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def lines(self) -> list[tuple[float, str, object]]:
        return [tuple(json.loads(line)) for line in self.file.read_text().splitlines()] if self.file.exists() else []

    def first(self, kind: str, value: object, after: float) -> float | None:
        return next((at for at, what, found in self.lines() if (what, found) == (kind, value) and at >= after), None)


class Pause:
    """A subject that was paused for so many seconds, and its peers."""

    def __init__(self, ros2: Ros2, folder: Path, seconds: float, burst: bool = False) -> None:
        self.folder, self.seconds = folder, seconds
        self.peer, self.subject, self.late = (Told(folder / name) for name in ("peer", "subject", "late"))
        subject, others = Hand(ros2, folder), Hand(ros2, folder)
        try:
            subject.run("python3", "/nodes/pausing_subject.py", "/told", detach=True)
            others.run("python3", "/nodes/pausing_peer.py", "/told", detach=True)
            for kind in ("in the graph", "service", "action"):
                wait_for(lambda kind=kind: self.peer.first(kind, True, 0.0), 60, kind)
            wait_for(lambda: {what for _, what, _ in self.subject.lines()} >= {*TOPICS}, 60, "messages")
            self.tell("goal-running")
            wait_for(lambda: self.peer.first("goal running accepted", None, 0.0), 60, "the goal")
            subject.api.pause(subject.id)
            self.paused = time.time()
            self.until(1.0)
            if burst:
                self.tell("burst-x")
            else:
                self.tell("call-early")
                self.tell("goal-early")
                others.run("python3", "/nodes/pausing_late.py", "/told", detach=True)
                if seconds > 25:
                    self.until(25.0)
                    self.tell("call-late")
            self.until(seconds)
            if burst:
                wait_for(lambda: self.peer.first("burst x ends", None, 0.0), 900, "the burst")
            subject.api.unpause(subject.id)
            self.resumed = time.time()
            self.until(self.resumed - self.paused + SETTLE)
        finally:
            subject.close()
            others.close()

    def tell(self, what: str) -> None:
        (self.folder / f"do-{what}").touch()

    def until(self, seconds: float) -> None:
        time.sleep(max(self.paused + seconds - time.time(), 0.0))

    def backlog(self, topic: str) -> str:
        """What came of the messages that were sent during the pause."""
        lines = [(at, float(age)) for at, what, age in self.subject.lines() if what == topic and at >= self.resumed]
        old = [age for at, age in lines if self.paused < at - age < self.resumed]
        return f"{len(old)} messages, the oldest {max(old):.1f} s old" if old else "nothing"

    def blocked(self, topic: str) -> str:
        during = [(what, v) for at, what, v in self.peer.lines() if self.paused < at < self.resumed]
        longest = max((float(v) for what, v in during if what == f"publish {topic} took"), default=0.0)
        failed = sum(what == f"publish {topic} failed" for what, _ in during)
        return f"at most {longest * 1000:.0f} ms, {failed} failed"

    def after(self, kind: str, value: object = None, whose: Told | None = None) -> str:
        """When it was so: seconds from the pause, or from the resumption if it came after that."""
        at = (whose or self.peer).first(kind, value, self.paused)
        if at is None:
            return "never"
        early = at < self.resumed
        return f"{at - self.paused:.1f} s after the pause" if early else f"{at - self.resumed:.1f} s after it resumes"

    def flows(self) -> str:
        found = (at for at, what, age in self.subject.lines() if what == TOPICS[0] and at - float(age) > self.resumed)
        return f"{next(found) - self.resumed:.1f} s after it resumes"


@pytest.mark.parametrize("seconds", [10, 30])
def test_a_pause(ros2, tmp_path, seconds):
    pause = Pause(ros2, tmp_path, float(seconds))
    print(f"\n\n## Paused for {seconds} s; {20 * seconds} messages were sent on each topic")
    for topic in TOPICS:
        print(f"- {topic}: publish {pause.blocked(topic)}; when it resumes it gets {pause.backlog(topic)}")
    print("- messages that are sent after it resumes arrive:", pause.flows())
    print("- leaves the graph:", pause.after("in the graph", False), "; is back:", back(pause, "in the graph"))
    print("- liveliness lost:", pause.after("alive", 0), "; is back:", back(pause, "alive", 1))
    print("- service not ready:", pause.after("service", False), "; ready:", back(pause, "service"))
    print("- call 1 s after the pause: answered", pause.after("call early answered"))
    print("- call 25 s after the pause: answered", pause.after("call late answered"))
    print("- action not ready:", pause.after("action", False), "; ready:", back(pause, "action"))
    print("- goal accepted before the pause: done", pause.after("goal running done"))
    print("- goal sent during the pause: accepted", pause.after("goal early accepted"), "done", end=" ")
    print(pause.after("goal early done"))
    print("- static transform for a late listener:", pause.after("static transform", None, pause.late))


def back(pause: Pause, kind: str, value: object = True) -> str:
    at = pause.peer.first(kind, value, pause.resumed)
    return f"{at - pause.resumed:.1f} s after it resumes" if at else "it was never away, or never came back"


def test_a_burst(ros2, tmp_path):
    pause = Pause(ros2, tmp_path, 2.0, burst=True)
    print(
        f"\n\n## A burst of 6,000 messages (reliable, keep all) during a pause of {pause.resumed - pause.paused:.0f} s"
    )
    print(f"- publish {pause.blocked('full')}; when it resumes it gets {pause.backlog('full')}")
