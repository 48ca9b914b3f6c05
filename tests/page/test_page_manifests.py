"""The editor of the page: it overwrites nobody's commit, and drops no text, in a real browser."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from common import wait_for
from page_browser import Ui, Watched, browser
from rorg_process import RorgProcess

MANIFESTS = {"tour": {"priority": 50}, "arm": {}}


def git(tree: Path, *words: str) -> str:
    identity = ("-c", "user.name=ada", "-c", "user.email=ada@example.org")
    return subprocess.run(["git", *identity, *words], cwd=tree, check=True, capture_output=True, text=True).stdout


@pytest.fixture(scope="module")
def robot(tmp_path_factory) -> Iterator[RorgProcess]:
    made = RorgProcess(tmp_path_factory.mktemp("robot"), MANIFESTS)
    for words in (["init", "-q"], ["add", "."], ["commit", "-qm", "A robot"]):
        git(made.tree, *words)
    made.start()
    wait_for(lambda: Path(made.socket()).exists(), 30, "rorg to answer")
    yield made
    made.close()


@pytest.fixture(scope="module")
def window(robot) -> Iterator[Watched]:
    ui = Ui(robot.socket())
    with browser() as chromium:
        context = chromium.new_context(viewport={"width": 1400, "height": 1000})
        context.set_default_timeout(20_000)
        made = Watched(context, ui.address)
        yield made
        context.close()
    ui.close()
    assert made.complaints == []


@pytest.fixture
def watched(robot, window) -> Iterator[Watched]:
    window.view("manifests")
    choose(window, "tour")
    yield window
    for name in ("tour", "arm"):
        choose(window, name)
        theirs = window.page.locator("button:text-is('Take theirs')")
        (theirs if theirs.count() else window.page.locator("button:text-is('Undo')")).click(force=True)


def choose(watched: Watched, name: str) -> None:
    watched.page.click(f".list button:text-is('Service {name}')")
    watched.page.wait_for_selector(f".editor textarea[aria-label='Text of services/{name}.yaml']")


def text_of(watched: Watched) -> str:
    return watched.page.locator(".editor textarea").input_value()


def by_another(robot, line: str) -> str:
    """Someone else changes a manifest while it is edited; the new text."""
    path = robot.tree / "services/tour.yaml"
    path.write_text(path.read_text() + f"# {line}\n")
    return path.read_text()


def typed(watched: Watched, more: str) -> str:
    text = text_of(watched) + f"# {more}\n"
    watched.page.fill(".editor textarea", text)
    return text


@pytest.mark.slow
def test_what_nobody_edits_is_loaded_anew(robot, watched):
    theirs = by_another(robot, "first")
    wait_for(lambda: text_of(watched) == theirs, 20, "their text")
    assert watched.page.locator(".overtaken").count() == 0


def test_typed_text_stays_and_a_commit_of_others_is_not_overwritten(robot, watched):
    mine = typed(watched, "mine")
    theirs = by_another(robot, "theirs")
    watched.page.wait_for_selector(".overtaken:has-text('services/tour.yaml was changed meanwhile')")
    assert text_of(watched) == mine
    assert watched.page.locator(".editor button.primary").is_disabled()
    watched.page.click("button:text-is('Show theirs')")
    assert watched.page.locator(".overtaken pre").inner_text().rstrip() == theirs.rstrip()
    watched.page.click("button:text-is('Keep mine on top of theirs')")
    watched.page.wait_for_selector(".overtaken", state="detached")
    assert text_of(watched) == mine
    watched.page.click(".editor button.primary:enabled")
    watched.page.wait_for_selector("text=Committed.")
    assert (robot.tree / "services/tour.yaml").read_text() == mine


def test_theirs_can_be_taken(robot, watched):
    typed(watched, "not so good")
    theirs = by_another(robot, "better")
    watched.page.click("button:text-is('Take theirs')")
    wait_for(lambda: text_of(watched) == theirs, 20, "their text")


def test_a_commit_that_comes_first_is_not_overwritten_before_the_page_has_heard_of_it(robot, watched):
    """The page asks with the digest of the text that it loaded, whatever its list says by then."""
    typed(watched, "late")
    sent: list[dict] = []
    watched.page.route(
        "**/api/v1/manifests/Service/tour", lambda route: (sent.append(route.request.post_data_json), route.continue_())
    )
    before = next(m["digest"] for m in robot.client().manifests() if m["name"] == "tour")
    by_another(robot, "early")
    watched.page.wait_for_selector(".overtaken")
    watched.page.unroute("**/api/v1/manifests/Service/tour")
    assert {body["base"] for body in sent if body} <= {before}


def test_text_is_kept_while_another_manifest_or_view_is_shown(robot, watched):
    mine = typed(watched, "unfinished")
    choose(watched, "arm")
    watched.page.wait_for_selector(".list li:has(button:text-is('Service tour')) span:text-is('not committed')")
    choose(watched, "tour")
    assert text_of(watched) == mine
    watched.view("now")
    watched.page.wait_for_selector(".node")
    watched.view("manifests")
    choose(watched, "tour")
    assert text_of(watched) == mine
    assert "unfinished" not in (robot.tree / "services/tour.yaml").read_text()


def test_a_commit_of_the_page_has_the_author_and_the_message_of_rorg_edit(robot, watched):
    client = robot.client()
    found = next(m for m in client.manifests() if m["name"] == "arm")
    client.put_manifest("Service", "arm", client.manifest("Service", "arm") + "# api\n", found["digest"])
    author = git(robot.tree, "log", "-1", "--format=%an <%ae>")
    typed(watched, "page")
    watched.page.click(".editor button.primary:enabled")
    watched.page.wait_for_selector("text=Committed.")
    assert git(robot.tree, "log", "-1", "--format=%an <%ae>") == author
    assert git(robot.tree, "log", "-1", "--format=%s") == "edit service tour\n"


def test_a_deleted_manifest_keeps_its_typed_text(robot, watched):
    text = (robot.tree / "services/tour.yaml").read_text()
    mine = typed(watched, "still here")
    (robot.tree / "services/tour.yaml").unlink()
    watched.page.wait_for_selector(".overtaken:has-text('services/tour.yaml was deleted meanwhile')")
    assert text_of(watched) == mine
    (robot.tree / "services/tour.yaml").write_text(text)
    watched.page.wait_for_selector(".overtaken", state="detached")
    assert text_of(watched) == mine
