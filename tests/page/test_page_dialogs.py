"""The dialogs of the page say what rorg would do, in a real browser, for a real rorg on the process engine."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import pytest
from common import wait_for
from page_browser import Ui, Watched, browser
from rorg_process import RorgProcess

ROBOT = {
    "core": {"always_on": True, "idle": {"linger": "0s"}},
    "camera": {"needs": ["core"], "exclusive": ["hand"], "priority": 80, "idle": {"linger": "0s"}},
    "detector": {"needs": ["camera"], "idle": {"linger": "0s"}},
    "teleop": {"needs": ["core"], "exclusive": ["hand"], "idle": {"linger": "0s"}},
    "slow": {"idle": {"linger": "1h"}},
    "arm": {"driver": True, "idle": {"linger": "0s"}},
}
GROUPS = {"seeing": {"services": ["detector"]}}


@pytest.fixture(scope="module")
def robot(tmp_path_factory) -> Iterator[RorgProcess]:
    made = RorgProcess(tmp_path_factory.mktemp("robot"), ROBOT, groups=GROUPS)
    made.start()
    wait_for(lambda: Path(made.socket()).exists(), 30, "rorg to answer")
    yield made
    made.close()


@pytest.fixture(scope="module")
def watched(robot) -> Iterator[Watched]:
    ui = Ui(robot.socket())
    with browser() as chromium:
        context = chromium.new_context(viewport={"width": 1400, "height": 1000})
        context.set_default_timeout(20_000)
        made = Watched(context, ui.address)
        yield made
        context.close()
    ui.close()
    assert made.complaints == []


@pytest.fixture(autouse=True)
def as_it_was(robot, watched) -> Iterator[None]:
    yield
    watched.page.keyboard.press("Escape")
    client = robot.client()
    client.call("DELETE", "/v1/suspension")
    for request in client.requests():
        client.release(request["id"])
    wait_for(lambda: states(robot)["core"] == "running" and not busy(robot), 30, "rest")


def states(robot) -> dict[str, str]:
    return {name: one["state"] for name, one in robot.client().status()["services"].items()}


def busy(robot) -> list[str]:
    running = {"camera", "detector", "teleop", "arm"}
    return [name for name, state in states(robot).items() if name in running and state == "running"]


def bring_up(robot, *services: str, id: str) -> None:
    robot.client().request(*services, id=id, ttl=None, wait=30)


def told(watched: Watched, service: str, button: str, *sentences: str) -> None:
    """The dialog behind a button of a service's drawer says this about what would change, and nothing else; the last
    sentence may go on."""
    watched.view(f"now/{service}")
    watched.page.wait_for_selector(f".drawer h2:has-text('{service}')")
    watched.page.click(f".drawer .buttons button:text-is('{button}')")
    lines = watched.page.locator("dialog .preview p:not(.quiet)")
    found: list[str] = []

    def right() -> bool:
        found[:] = lines.all_inner_texts() or found
        return len(found) == len(sentences) and all(map(str.startswith, found, sentences))

    with contextlib.suppress(AssertionError):
        wait_for(right, 10)
    watched.page.click("dialog button:text-is('Cancel')")
    assert right(), found


@pytest.mark.slow
def test_a_request_names_what_starts_and_who_gives_way(robot, watched):
    bring_up(robot, "teleop", id="drive")
    gives_way = "Stops teleop, which gives way to camera (waits for hand, which is taken by camera)."
    told(watched, "detector", "Request", "Starts camera and detector.", gives_way)


def test_who_loses_is_told_before_it_asks(robot, watched):
    bring_up(robot, "camera", id="see")
    lost = "teleop gives way to camera (waits for hand, which is taken by camera)."
    told(watched, "teleop", "Request", lost)


def test_a_request_of_a_group_is_released_with_what_it_wants(robot, watched):
    bring_up(robot, "seeing", id="look")
    bring_up(robot, "camera", id="see")
    ends = ("Stops detector.", "No longer wanted: detector.")
    told(watched, "detector", "Release look", *ends)


def test_an_idle_service_lingers_and_a_request_keeps_it(robot, watched):
    bring_up(robot, "slow", id="s")
    waits = "slow: lingers for "
    told(watched, "slow", "Release s", "No longer wanted: slow.", waits)
    robot.client().release("s")
    told(watched, "slow", "Request", "slow is wanted from now on, and stays as it is.")


def test_a_request_that_changes_nothing_says_so(robot, watched):
    told(watched, "core", "Request", "Nothing changes now.")


def test_while_rorg_is_suspended_a_request_waits(robot, watched):
    robot.client().call("PUT", "/v1/suspension", {"duration": "1h", "reason": "cleaning"})
    watched.page.wait_for_selector(".troubles .suspended")
    watched.view("now/arm")
    watched.page.click(".drawer .buttons button:text-is('Request')")
    watched.page.wait_for_selector("dialog .preview p:has-text('arm waits: suspended until')")
    watched.page.click("dialog button:text-is('Cancel')")


def test_a_driver_is_released_once_a_person_has_seen_its_name(robot, watched):
    bring_up(robot, "arm", id="move")
    watched.view("now/arm")
    watched.page.click(".drawer .buttons button:text-is('Release move')")
    watched.page.wait_for_selector("dialog .preview p:has-text('Affected: arm. arm moves hardware.')")
    watched.page.click("dialog button.primary:text-is('Release all the same')")
    wait_for(lambda: "arm" not in busy(robot), 20, "its end")


def test_the_dialog_follows_what_happens_meanwhile(robot, watched):
    watched.view("now/detector")
    watched.page.click(".drawer .buttons button:text-is('Request')")
    watched.page.wait_for_selector("dialog .preview p:has-text('Starts camera and detector.')")
    bring_up(robot, "camera", id="see")
    watched.page.wait_for_selector("dialog .preview p:text-is('Starts detector.')")
    watched.page.click("dialog button:text-is('Cancel')")
