"""The page with 300 services and 50 events a second: how long it blocks, what it keeps, and what it costs the loop.
PAGE_MINUTES=10 for the long look at its memory."""

from __future__ import annotations

import bisect
import json
import os
import statistics
import threading
import time
from dataclasses import dataclass

import psutil
import pytest
from common import wait_for
from page_browser import Ui, Watched, browser
from rorg_process import RorgProcess

COUNT, RATE = 300, 50
MINUTES = float(os.environ.get("PAGE_MINUTES", "0.5"))
LAYERS = 6


def services() -> dict[str, dict]:
    """Six layers, each service with two needs in the layer below."""
    made: dict[str, dict] = {}
    for n in range(COUNT):
        layer, place = divmod(n, COUNT // LAYERS)
        below = (layer - 1) * (COUNT // LAYERS)
        needs = [f"s{below + (place + k) % (COUNT // LAYERS):03}" for k in (0, 7)] if layer else []
        made[f"s{n:03}"] = {"needs": needs, "always_on": n < 5}
    return made


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    made = RorgProcess(tmp_path_factory.mktemp("page"), services())
    made.start()
    wait_for(lambda: os.path.exists(made.socket()), 60, "rorg to answer")
    wait_for(lambda: made.client().plan()["actions"] == [], 120, "all to have containers")
    yield made
    made.close()


class Busy:
    """Makes so many events a second: requests that come and go."""

    def __init__(self, robot: RorgProcess, rate: float = RATE) -> None:
        self.client, self.made, self.ended, self.rate = robot.client(), 0, threading.Event(), rate
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        began = time.monotonic()
        while not self.ended.is_set():
            self.client.call("PUT", "/v1/requests/busy", {"services": ["s000"], "reason": f"number {self.made}"})
            self.client.release("busy")
            self.made += 2
            self.ended.wait(max(0.0, began + self.made / self.rate - time.monotonic()))

    def __enter__(self) -> Busy:
        return self

    def __exit__(self, *_: object) -> None:
        self.ended.set()


def cores(robot: RorgProcess, seconds: float) -> float:
    """CPU of the loop's process, in cores."""
    process = psutil.Process(robot.process.pid)
    before, began = sum(process.cpu_times()[:2]), time.monotonic()
    time.sleep(seconds)
    return (sum(process.cpu_times()[:2]) - before) / (time.monotonic() - began)


FRAME = 50.0
"""Milliseconds: from here on a browser calls a task long."""
USED = "async () => { gc(); return performance.memory.usedJSHeapSize; }"
MARK = "number => performance.mark('view ' + number)"


@dataclass(frozen=True)
class Task:
    """What the page's thread did at one go, in milliseconds: its time on the clock, and its own on a core."""

    view: str
    clock: float
    core: float
    turned: bool
    """Whether it began within a second of a change of view."""

    def __str__(self) -> str:
        return f"{self.view} {self.clock:.0f} ({self.core:.0f})"


def long_tasks(trace: bytes, views: list[str]) -> list[Task]:
    """The tasks over FRAME of the page's thread, from a trace in which a mark stands before each of these views."""
    events = json.loads(trace)["traceEvents"]
    marks = sorted((e["ts"], e["pid"], e["tid"]) for e in events if e["name"].startswith("view "))
    assert len(marks) == len(views)
    thread, starts = marks[0][1:], [at for at, *_ in marks]
    found = []
    for event in events:
        if (event["pid"], event["tid"]) != thread or not event["name"].endswith("RunTask") or event["ts"] < starts[0]:
            continue
        if event.get("dur", 0) > FRAME * 1000:
            number = bisect.bisect_right(starts, event["ts"]) - 1
            turned = event["ts"] - starts[number] < 1e6
            found.append(Task(views[number], event["dur"] / 1000, event["tdur"] / 1000, turned))
    return found


def test_a_page_of_300_services_stays_smooth_and_small(robot):
    ui = Ui(robot.socket())
    with browser("--js-flags=--expose-gc", "--enable-precise-memory-info") as chromium, Busy(robot) as busy:
        watched = Watched(chromium.new_context(viewport={"width": 1400, "height": 1000}), ui.address)
        watched.page.wait_for_selector(f".node >> nth={COUNT - 1}")
        time.sleep(3)  # what it takes to begin is not a frame that anyone waits for
        chromium.start_tracing(page=watched.page, categories=["toplevel", "blink.user_timing"])
        made, began = busy.made, time.monotonic()
        sizes, views, ended = [], [], time.monotonic() + 60 * MINUTES
        while time.monotonic() < ended:
            for view in ("now", "time", "now/s299"):
                watched.page.evaluate(MARK, len(views))
                views.append(view)
                watched.view(view)
                time.sleep(6)
            sizes.append(watched.page.evaluate(USED))
        rate = (busy.made - made) / (time.monotonic() - began)
        found = long_tasks(chromium.stop_tracing(), views)
        print(f"page: {rate:.0f} events a second; tasks over {FRAME:.0f} ms, in milliseconds (of them on a core):")
        for name, turned in (("within a second of another view", True), ("at other times", False)):
            print(f"page: {name}: {', '.join(str(one) for one in found if one.turned is turned) or 'none'}")
        print(f"page: heap {sizes[0] / 2**20:.1f} MiB at first, {sizes[-1] / 2**20:.1f} MiB after {MINUTES:g} minutes")
        assert watched.complaints == []
        half = len(sizes) // 2
        if half > 5:
            assert statistics.median(sizes[half:]) < 1.2 * statistics.median(sizes[1:half])
    ui.close()
    # On the clock, a task also waits for its core, which the robot, the browser and this test share.
    assert [one for one in found if one.core > FRAME] == []


def test_five_pages_cost_the_loop_little(robot):
    """At a rate that leaves the loop time: at a full core nothing could be added."""
    with Busy(robot, 4):
        alone = cores(robot, 10)
        ui = Ui(robot.socket())
        with browser() as chromium:
            for _ in range(5):
                Watched(chromium.new_context(), ui.address)
            time.sleep(3)
            beside = cores(robot, 10)
        ui.close()
    print(f"page: the loop takes {100 * alone:.1f} % of a core alone, and {100 * beside:.1f} % with five pages")
    assert beside - alone < 0.03
