"""What the page says of services is what the API says of them, in situations of a real rorg on the process engine."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from common import wait_for
from page_browser import Ui, Watched, browser
from robots import WORK, write_tree
from rorg_process import RorgProcess

SLOW = ["sh", "-c", "trap '' TERM INT; while :; do sleep 0.1; done"]
NEVER = {"file": "/nonexistent/ready", "timeout": "1h"}
ROBOT = {
    "lingers": {"idle": {"linger": "1h"}},
    "paused": {"idle": {"action": "pause", "linger": "0s"}},
    "stops": {"command": SLOW, "idle": {"action": "stop", "linger": "0s"}, "container": {"stop_grace_period": "1h"}},
    "camera": {"exclusive": ["hand"], "priority": 80},
    "teleop": {"exclusive": ["hand"]},
    "map": {"ready": NEVER},
    "nav": {"needs": ["map"]},
    "held": {"idle": {"linger": "0s"}},
    "worse": {"ready": {"delay": "0s"}},
    "trial": {"update": {"bake": "1h"}},
    "crash": {"command": ["sh", "-c", "exit 3"], "restart": "always"},
    "noprogram": {"command": ["/no/such/program"]},
    "arm": {"driver": True},
    "done": {"command": ["true"], "restart": "never"},
    "gone": {"idle": {"action": "remove", "linger": "0s"}},
}
EDITED = {
    **ROBOT,
    "worse": {**ROBOT["worse"], "command": ["sh", "-c", "exit 7"]},
    "trial": {**ROBOT["trial"], "command": [*WORK, "edited"]},
    "arm": {**ROBOT["arm"], "command": [*WORK, "edited"]},
}
STANDING = {"always": {"requester": "camera", "services": ["nav"]}}


@pytest.fixture(scope="module")
def robot(tmp_path_factory) -> Iterator[RorgProcess]:
    made = RorgProcess(tmp_path_factory.mktemp("robot"), ROBOT, requests=STANDING)
    made.start()
    wait_for(lambda: Path(made.socket()).exists(), 30, "rorg to answer")
    client = made.client(patience=20.0)
    for name in ROBOT:
        if name not in ("map", "gone"):
            client.call("PUT", f"/v1/requests/{name}", {"services": [name], "ttl": "1h" if name == "camera" else None})
    up = ("lingers", "paused", "stops", "held", "worse", "trial", "arm", "camera")
    wait_for(lambda: all(state(made, name) == "running" for name in up), 60, "its services")
    client.call("PUT", "/v1/holds/held", {"duration": "1h", "reason": "cleaning"})
    for name in ("lingers", "paused", "stops"):
        client.release(name)
    write_tree(made.tree, EDITED, requests=STANDING)
    yield made
    made.close()


@pytest.fixture(scope="module")
def watched(robot) -> Iterator[Watched]:
    ui = Ui(robot.socket())
    with browser() as chromium:
        context = chromium.new_context(viewport={"width": 1400, "height": 1000})
        context.set_default_timeout(30_000)
        made = Watched(context, ui.address)
        yield made
        context.close()
    ui.close()
    assert made.complaints == []


def state(robot, name: str) -> str:
    return robot.client().service(name)["state"]


SENTENCES = {
    "lingers": "idle, still running: lingers for ",
    "paused": "idle, paused",
    "stops": "stopping",
    "camera": "ready",
    "teleop": "kept out: waits for hand, which is taken by camera",
    "map": "starting: file /nonexistent/ready: No such file or directory",
    "nav": "starting: map is not ready (",
    "held": "kept out: held until ",
    "worse": "ready; its change failed: ended with exit code 7; change it again, or `rorg retry worse`",
    "trial": "ready, on trial; the previous container is kept until this one has been well (",
    "crash": "failing: ended with exit code 3; again in ",
    "noprogram": "failing: start stalled: no program /no/such/program",
    "arm": "ready; changed: command; arm is in use; `rorg apply` confirms the change",
    "done": "completed",
    "gone": "no container",
}


@pytest.mark.parametrize("name", ROBOT)
def test_a_service_is_described_as_it_is(robot, watched, name):
    watched.view(f"now/{name}")
    watched.page.wait_for_selector(f".drawer h2:has-text('{name}')")
    text = watched.page.locator(".drawer > p").first
    wait_for(lambda: text.inner_text().startswith(SENTENCES[name]), 60, f"{name}: {SENTENCES[name]}")


def test_nothing_waits_for_waiting(watched):
    watched.view("now/teleop")
    watched.page.wait_for_selector(".drawer li:text-is('It waits for hand, which is taken by camera')")
    watched.page.wait_for_selector(".facts li:text-is('teleop waits for hand, which is taken by camera')")
    watched.page.wait_for_selector(".facts li:has-text('lingers: lingers for')")
    watched.page.wait_for_selector(".facts li:has-text('stop stops is under way')")


def test_requests_say_what_is_left_of_their_lease_and_which_are_declared(watched):
    watched.page.wait_for_selector(".facts li:has-text('camera by developer'):has-text('left of its lease of 60 min')")
    declared = watched.page.locator(".facts li:has-text('nav by camera'):has-text('declared in a manifest')")
    declared.wait_for()
    assert declared.locator("button").count() == 0


def test_the_last_events_come_first_however_many_the_page_knows(robot, watched):
    watched.view("now/crash")
    events = watched.page.locator(".drawer .events li")

    def told() -> bool:
        known = [e["message"] for e in robot.client().events(tail=12, only={"service": ["crash"]}) if "message" in e]
        shown = events.all_inner_texts()
        return len(shown) == 12 and all(
            text.endswith(message) for text, message in zip(shown, known[::-1], strict=True)
        )

    wait_for(told, 60, "its last twelve events")


def test_what_crashes_can_be_restarted_at_once(watched):
    watched.view("now/crash")
    watched.page.wait_for_selector(".drawer button:text-is('Restart'):enabled")
    watched.view("now/lingers")
    watched.page.wait_for_selector(".drawer button:text-is('Restart'):disabled")


def test_a_suspension_is_said_once_and_then_the_end_of_the_robot(robot, watched):
    robot.client().call("PUT", "/v1/suspension", {"duration": "1h", "reason": "cleaning"})
    line = watched.page.locator(".troubles .suspended")
    line.wait_for()
    assert line.inner_text().startswith("rorg is suspended until ")
    robot.client().call("DELETE", "/v1/suspension")
    line.wait_for(state="detached")
    robot.client().call("PUT", "/v1/down", {})
    watched.page.wait_for_selector(".troubles .down:text-is('The robot is being taken down.')")
