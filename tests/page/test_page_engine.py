"""What the page says while an engine is silent or has no image, in a real browser, on a real Docker engine."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from common import wait_for
from frozen import frozen, silent
from page_browser import Ui, Watched, browser

pytestmark = pytest.mark.docker


@pytest.fixture
def robot(docker_robot):
    docker_robot.with_server = True
    docker_robot.declare({"arm": {"always_on": True}, "lidar": {}, "blind": {"image": "no.invalid/nowhere:1"}})
    docker_robot.wait(lambda: docker_robot.active() == {"arm"})
    yield docker_robot
    wait_for(lambda: not silent(docker_robot), 60, "the engine to answer again")


@pytest.fixture
def watched(robot) -> Iterator[Watched]:
    ui = Ui(robot.socket())
    with browser() as chromium:
        context = chromium.new_context(viewport={"width": 1400, "height": 1000})
        context.set_default_timeout(60_000)
        made = Watched(context, ui.address)
        yield made
        context.close()
    ui.close()
    assert made.complaints == []


def test_a_silent_engine_and_a_missing_image_are_told(robot, watched, dockerd):
    robot.client().call("PUT", "/v1/requests/blind", {"services": ["blind"]})
    watched.view("now/blind")
    blind = watched.page.locator(".drawer > p").first
    wait_for(lambda: blind.inner_text().startswith("failing: "), 90, "the missing image")
    assert "no.invalid/nowhere:1" in blind.inner_text()
    with frozen(dockerd):
        trouble = watched.page.locator(".troubles .engine")
        trouble.wait_for()
        assert "has not answered since" in trouble.inner_text()
        watched.view("now/arm")
        watched.page.wait_for_selector(".drawer > p:text-is('unknown')")
        watched.page.wait_for_selector(".drawer li:has-text('has not answered since')")
        watched.view("now/lidar")
        watched.page.click(".drawer button:text-is('Request')")
        watched.page.wait_for_selector("dialog .preview p:has-text('lidar waits: the engine at')")
        assert watched.page.locator(".log").count() == 0, "nobody knows what it has printed"
        watched.page.keyboard.press("Escape")
