"""The page of `rorg ui`, in a real browser, for a real rorg on the process engine."""

from __future__ import annotations

import http.client
import json
import re
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import pytest
import yaml
from commands import rorg
from common import wait_for
from page_browser import Ui, Watched, browser
from page_firefox import Firefox
from robots import write_tree
from rorg_process import RorgProcess

from rorg.history.database import Database
from rorg.history.usage import MACHINE, Measured, UsageTable
from rorg.model.units import stamp

TOUR = {
    "tour": {"needs": ["navigation"]},
    "navigation": {"needs": ["localization"], "idle": {"linger": "0s"}},
    "localization": {},
    "arm": {"always_on": True, "driver": True},
    "extra": {"needs": ["arm"]},
}
HOSTILE = "<img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def chromium():
    with browser() as made:
        yield made


@pytest.fixture
def robot(tmp_path) -> Iterator[RorgProcess]:
    made = RorgProcess(tmp_path, TOUR)
    for words in (["init", "-q"], ["add", "."], ["commit", "-qm", "A robot"]):
        identity = ("-c", "user.name=ada", "-c", "user.email=ada@example.org")
        subprocess.run(["git", *identity, *words], cwd=made.tree, check=True, capture_output=True)
    made.start()
    wait_for(lambda: Path(made.socket()).exists(), 30, "rorg to answer")
    yield made
    made.close()


@pytest.fixture
def ui(robot) -> Iterator[Ui]:
    made = Ui(robot.socket())
    yield made
    made.close()


@pytest.fixture
def watched(chromium, ui) -> Iterator[Watched]:
    context = chromium.new_context(viewport={"width": 1400, "height": 1000})
    context.set_default_timeout(20_000)
    made = Watched(context, ui.address)
    yield made
    context.close()
    assert made.complaints == []


def node(watched: Watched, name: str, text: str) -> None:
    watched.page.wait_for_selector(f'.node[aria-label="{name}: {text}"]')


@pytest.mark.slow
def test_the_tour_comes_and_goes(robot, watched):
    """Without a reload: localization comes with what needs it, and goes with it."""
    client = robot.client()
    node(watched, "localization", "stopped")
    client.call("PUT", "/v1/requests/t", {"services": ["tour"]})
    node(watched, "localization", "ready")
    node(watched, "tour", "ready")
    watched.page.hover('.node[aria-label^="localization"]')
    watched.page.wait_for_selector('.node.lit[aria-label^="tour"]')
    assert watched.page.locator('.node.lit[aria-label^="arm"]').count() == 0, "it is in no chain with it"
    client.release("t")
    node(watched, "localization", "stopped")


@pytest.mark.slow
def test_why_is_one_click_away(robot, watched):
    robot.client().call("PUT", "/v1/requests/t", {"services": ["tour"], "reason": "a visitor"})
    watched.page.click(".services button:text-is('localization')")
    chain = watched.page.locator(".drawer .chain li")
    chain.nth(3).wait_for()
    assert chain.all_inner_texts() == [
        "localization (needed by navigation)",
        "navigation (needed by tour)",
        "tour (requested by developer (t))",
        "developer (meta-service)",
    ]
    watched.page.wait_for_selector(".drawer .events li:has-text('localization is ready')")
    watched.page.wait_for_selector(".drawer td:has-text('profile common')")
    watched.page.wait_for_selector(".drawer tr:has(th:text-is('restart')) td:text-is('default')")
    watched.page.keyboard.press("Escape")
    watched.page.wait_for_selector(".drawer", state="detached")


@pytest.mark.slow
def test_a_request_is_made_and_released_and_shows_its_plan_first(robot, watched):
    watched.view("now/tour")
    watched.page.click(".drawer button:text-is('Request')")
    watched.page.wait_for_selector("dialog p:has-text('Starts localization, navigation and tour.')")
    assert robot.client().requests() == []
    watched.page.fill("dialog input[name=reason]", "to try it")
    watched.page.click("dialog button.primary")
    node(watched, "tour", "ready")
    assert [r["reason"] for r in robot.client().requests()] == ["to try it"]
    watched.page.click(".drawer button:text-is('Release tour')")
    watched.page.wait_for_selector("dialog p:has-text('No longer wanted: localization, navigation and tour.')")
    watched.page.click("dialog button.primary")
    node(watched, "tour", "stopped")


@pytest.mark.slow
def test_a_restart_says_what_restarts(robot, watched):
    robot.client().call("PUT", "/v1/requests/t", {"services": ["tour"]})
    node(watched, "tour", "ready")
    run = robot.client().service("localization")["incarnation"]
    watched.view("now/localization")
    watched.page.click(".drawer button:text-is('Restart')")
    watched.page.wait_for_selector("dialog p:has-text('Restarts localization.')")
    watched.page.click("dialog button.primary")
    wait_for(lambda: robot.client().service("localization")["incarnation"] not in ("", run), 20, "the restart")


@pytest.mark.slow
def test_a_hold_says_that_it_stops_the_service_and_asks_for_a_driver(robot, watched):
    node(watched, "arm", "ready")
    watched.view("now/arm")
    watched.page.click(".drawer button:text-is('Hold')")
    watched.page.wait_for_selector("dialog p:has-text('Stops arm, which is kept out: held until')")
    watched.page.wait_for_selector("dialog p:has-text('Affected: arm. arm moves hardware.')")
    assert robot.client().service("arm")["state"] == "running", "it is a driver"
    watched.page.click("dialog button.primary:has-text('Hold all the same')")
    node(watched, "arm", "kept out")
    watched.page.wait_for_selector(".drawer .chain li:has-text('arm (always on)')")
    watched.page.wait_for_selector(".drawer li:has-text('rorg hold arm --end')")
    assert robot.client().service("arm")["health"] == "Waiting"


@pytest.mark.slow
def test_rorg_is_suspended_and_goes_on(robot, watched):
    watched.page.click("button:text-is('Suspend rorg')")
    watched.page.fill("dialog input[name=reason]", "maintenance")
    watched.page.click("dialog button.primary")
    watched.page.wait_for_selector(".troubles .suspended:has-text('maintenance')")
    robot.client().call("PUT", "/v1/requests/t", {"services": ["tour"]})
    watched.page.wait_for_selector(".facts li:has-text('start navigation'), .facts li:has-text('start localization')")
    watched.page.click("button:text-is('End the suspension')")
    watched.page.wait_for_selector("dialog p:has-text('Starts localization, navigation and tour.')")
    watched.page.click("dialog button.primary")
    node(watched, "tour", "ready")


@pytest.mark.slow
def test_a_group_is_shown_alone(robot, watched):
    write_tree(robot.tree, TOUR, groups={"driving": {"services": ["navigation", "localization"]}})
    watched.page.select_option("label:has-text('Group') select", "driving")
    rows = watched.page.locator(".services tbody tr th")
    wait_for(lambda: sorted(rows.all_inner_texts()) == ["localization", "navigation"], 10, "its members alone")


@pytest.mark.slow
def test_the_loop_is_lost_and_comes_back(robot, watched):
    robot.stop(kill=True)
    watched.page.wait_for_selector(".troubles .lost")
    robot.start()
    watched.page.wait_for_selector(".troubles .lost", state="detached")
    robot.client(patience=10.0).call("PUT", "/v1/requests/t", {"services": ["tour"]})
    node(watched, "tour", "ready")


@pytest.mark.slow
def test_a_refused_commit_shows_its_line(robot, watched):
    path = robot.tree / "services/tour.yaml"
    path.write_text(path.read_text() + "  nonsense: 1\n")
    line = len(path.read_text().splitlines())
    watched.page.wait_for_selector(f".troubles .refused:has-text('tour.yaml:{line}:')")


@pytest.mark.slow
def test_a_manifest_is_checked_while_it_is_edited_and_committed(robot, watched):
    watched.view("manifests")
    watched.page.click(".list button:text-is('Service tour')")
    text = watched.page.locator(".editor textarea")
    text.wait_for()
    before = text.input_value()
    text.fill(before + "  nonsense: 1\n")
    line = len(before.splitlines()) + 1
    watched.page.wait_for_selector(f".mistakes li:has-text('tour.yaml:{line}:')")
    assert watched.page.locator(".gutter .wrong").inner_text().strip() == f"▲{line}"
    assert watched.page.locator(".editor button.primary").is_disabled()
    good = before.replace("needs:\n  - navigation", "needs:\n  - navigation\n  priority: 70")
    text.fill(good)
    watched.page.wait_for_selector(".editor button.primary:enabled")
    watched.page.fill(".editor .buttons input", "Guide visitors first")
    watched.page.click(".editor button.primary")
    watched.page.wait_for_selector("text=Committed.")
    log = subprocess.run(
        ["git", "log", "-1", "--format=%s"], cwd=robot.tree, capture_output=True, text=True, check=True
    )
    assert log.stdout == "Guide visitors first\n"
    assert yaml.safe_load((robot.tree / "services/tour.yaml").read_text())["spec"]["priority"] == 70


@pytest.mark.slow
def test_what_was_is_there_over_time(robot, watched):
    client = robot.client()
    client.call("PUT", "/v1/requests/t", {"services": ["tour"], "reason": "a visitor"})
    node(watched, "tour", "ready")
    client.release("t")
    node(watched, "tour", "stopped")
    watched.view("time")
    request = watched.page.locator('.lanes [aria-label^="tour for developer"] .bar')
    request.wait_for()
    watched.page.click("button[aria-label='Zoom in']")

    def gap() -> float:
        """Between its end and the present, in points."""
        bar, lanes = request.bounding_box(), watched.page.locator(".lanes >> nth=0").bounding_box()
        return float(lanes["x"] + lanes["width"] - bar["x"] - bar["width"])

    first = gap()
    wait_for(lambda: gap() > first + 8, 20, "the time since its release to grow")
    watched.page.click("button:text-is('5 min')")
    watched.page.wait_for_selector('.lane svg[aria-label^="tour exited"]')
    for name in TOUR:
        watched.page.wait_for_selector(f'.lane:has(button:text-is("{name}")) .bar')
    bars = watched.page.locator('.lane:has(button:text-is("tour")) .bar')
    assert "ready" in {bars.nth(n).get_attribute("class").split()[-1] for n in range(bars.count())}
    database = Database(robot.state / "journal.db", lambda: "")
    now = time.time()
    UsageTable(database).note(stamp(now - 7200), [Measured(MACHINE, "", 60.0, 45.0, 1 << 30)])
    database.close()

    def of_hours(answer) -> bool:
        """Whether it is for the three hours, rather than for the minutes that were shown before."""
        url = urlsplit(answer.url)
        return url.path.endswith("/v1/measured/slots") and parse_qs(url.query)["since"][0] < stamp(now - 7200)

    with watched.page.expect_response(of_hours) as told:
        watched.page.click("button:text-is('3 h')")
    assert [slot["cores"] for slot in told.value.json()["answer"]] == [0.75], "last night is there too"
    watched.page.click("button[aria-label='Earlier']")
    assert watched.page.locator("button:text-is('Live')").get_attribute("aria-pressed") == "false"
    watched.page.locator('.lane:has(button:text-is("tour")) button').click()
    watched.page.wait_for_selector(".drawer h2:has-text('tour')")


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [360, 1400])
def test_everybody_can_use_every_view(robot, chromium, ui, scheme, width):
    robot.client().call("PUT", "/v1/requests/t", {"services": ["tour"], "reason": "a visitor"})
    context = chromium.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme, bypass_csp=True)
    watched = Watched(context, ui.address)
    found: dict[str, list[str]] = {}
    try:
        for view, there in (
            ("now", ".node.ready"),
            ("now/tour", ".drawer .chain li"),
            ("time", ".lane .bar.ready"),
            ("manifests", ".list li"),
        ):
            watched.view(view)
            watched.page.wait_for_selector(there)
            found[view] = watched.mistakes()
            wide = watched.page.evaluate("document.documentElement.scrollWidth")
            assert wide <= width, f"{view} is {wide} wide"
        watched.page.click(".list button >> nth=0")
        watched.page.wait_for_selector(".editor textarea")
        found["editor"] = watched.mistakes()
        watched.view("now/extra")
        watched.page.click(".drawer button:text-is('Request')")
        watched.page.wait_for_selector("dialog[open]")
        found["dialog"] = watched.mistakes()
    finally:
        context.close()
    assert {view: mistakes for view, mistakes in found.items() if mistakes} == {}


# -- who may do what -------------------------------------------------------------------------------------------


def ask(ui: Ui, method: str, path: str, body: str = "", timeout: float = 20.0, **headers: str) -> tuple[int, str]:
    place = urlsplit(ui.origin)
    connection = http.client.HTTPConnection(place.hostname or "", place.port, timeout=timeout)
    connection.request(method, path, body or None, {k.replace("_", "-"): v for k, v in headers.items()})
    answer = connection.getresponse()
    return answer.status, answer.read().decode()


def cookie(ui: Ui) -> str:
    return f"rorg_ui_{urlsplit(ui.origin).port}={ui.token}"


def test_only_the_token_opens_the_page(ui):
    for given in ("", "x" * len(ui.token), ui.token[:-1]):
        assert ask(ui, "GET", f"/?token={given}")[0] == 401
    for path in ("/", "/feed", "/api/v1/status", "/page/main.js"):
        assert ask(ui, "GET", path)[0] == 401
        assert ask(ui, "GET", path, cookie=cookie(ui)[:-1])[0] == 401
    assert ask(ui, "GET", "/api/v1/status", cookie=cookie(ui))[0] == 200
    assert ask(ui, "GET", "/api/v1/status", cookie=cookie(ui), host="robot.example")[0] == 403


def test_a_question_for_the_head_alone_is_answered_like_any_other(ui):
    for path in ("/", "/feed", "/api/v1/status", "/page/main.js"):
        assert ask(ui, "HEAD", path, cookie=cookie(ui), timeout=5.0) == (200, "")


@pytest.mark.slow
def test_half_a_question_holds_nothing_for_long(ui):
    """As many connections as the page's server may have files open, without a token."""
    place = urlsplit(ui.origin)
    halves = []
    try:
        for begin in ("", "GET / HT", "PUT /api/v1/requests/x HTTP/1.1\r\ncontent-length: 9\r\n\r\n{") * 400:
            halves.append(half := socket.create_connection((place.hostname, place.port), 20))
            half.sendall(begin.encode())
        assert ask(ui, "GET", "/api/v1/status", cookie=cookie(ui))[0] == 200
        wait_for(lambda: all(map(ended, halves)), 60, "the end of all of them")
    finally:
        for half in halves:
            half.close()


def ended(connection: socket.socket) -> bool:
    """Whether the other end has ended it."""
    connection.setblocking(False)
    try:
        while connection.recv(4096):
            pass
    except BlockingIOError:
        return False
    except OSError:
        pass
    return True


@pytest.mark.slow
def test_calls_that_wait_delay_no_other(ui):
    waits = []
    try:
        for _ in range(60):
            waits.append(wait := http.client.HTTPConnection(urlsplit(ui.origin).netloc, timeout=60))
            wait.request("GET", "/api/v1/wait?services=tour&timeout=40", headers={"cookie": cookie(ui)})
        began = time.monotonic()
        assert ask(ui, "GET", "/api/v1/status", cookie=cookie(ui))[0] == 200
        assert time.monotonic() - began < 5.0
    finally:
        for wait in waits:
            wait.close()


def test_another_page_can_neither_read_nor_send(robot, chromium, ui, tmp_path):
    """Of another origin, in the same browser, after the page was opened there."""
    context = chromium.new_context()
    Watched(context, ui.address)
    other = Ui(robot.socket())  # another server on this machine: the same host, another port
    try:
        page = context.new_page()
        page.goto(other.address)
        told = page.evaluate(
            """async (origin) => {
              const tried = [];
              for (const [method, path] of [["GET", "/api/v1/status"], ["PUT", "/api/v1/requests/x"]]) {
                try {
                  const answer = await fetch(origin + path, {method, credentials: "include", mode: "no-cors",
                    body: method === "PUT" ? '{"services": ["tour"]}' : undefined});
                  tried.push(answer.type === "opaque" ? "opaque" : await answer.text());
                } catch (error) { tried.push("refused"); }
              }
              return tried;
            }""",
            ui.origin,
        )
        assert set(told) <= {"refused", "opaque"}
        page.set_content(f"<form method=post action='{ui.origin}/api/v1/retries'></form>")
        page.evaluate("document.forms[0].submit()")
    finally:
        other.close()
        context.close()
    assert robot.client().requests() == []
    for origin in ("http://127.0.0.1:1", "null", "https://example.org"):
        status, text = ask(ui, "PUT", "/api/v1/requests/x", '{"services": ["tour"]}', cookie=cookie(ui), origin=origin)
        assert (status, text) == (403, "another page may not use this one")
    assert ask(ui, "GET", "/feed", cookie=cookie(ui), sec_fetch_site="cross-site")[0] == 403
    assert robot.client().requests() == []


@pytest.mark.slow
def test_a_read_only_page_changes_nothing_whatever_it_sends(robot, chromium):
    ui = Ui(robot.socket(), "--read-only")
    try:
        document = json.loads(Path("schemas/openapi.json").read_text())
        before = robot.client().status()["requests"]
        for path, methods in document["paths"].items():
            for method in methods:
                if method.upper() != "GET":
                    filled = path.replace("{name}", "tour").replace("{id}", "x").replace("{kind}", "Service")
                    filled = filled.replace("{domain}", "0")
                    body = '{"services": ["tour"], "text": "x"}'
                    status, _ = ask(ui, method.upper(), f"/api{filled}", body, cookie=cookie(ui))
                    assert status == 403, (method, path)
        assert robot.client().status()["requests"] == before
        assert robot.client().status()["down"] == ""
        context = chromium.new_context()
        watched = Watched(context, ui.address)
        watched.view("now/tour")
        watched.page.wait_for_selector(".drawer h2")
        assert watched.page.locator(".drawer .buttons button").count() == 0
        context.close()
    finally:
        ui.close()


@pytest.mark.slow
def test_requests_that_are_held_are_told_once_and_those_that_are_gone_end(watched):
    def record(at: int, id: str, *services: str) -> dict[str, object]:
        return {"at": f"T{at}", "requester": "guide", "id": id, "services": list(services)}

    before = [record(1, "held", "arm"), record(2, "gone", "camera"), record(3, "over", "map"), record(4, "over")]
    told = {"begin": "T5", "requests": [record(5, "held", "arm"), record(5, "late", "map"), record(6, "held")]}
    script = "async told => (await import('/page/lanes.js')).continued(...told)"
    after = watched.page.evaluate(script, [before, told])
    assert after[:4] == before
    assert after[4:] == [record(5, "gone"), record(5, "late", "map"), record(6, "held")]


def test_hostile_text_stays_text(robot, watched):
    """In a reason, a log line, a description and the message of a commit."""
    spec = {"image": "x", "command": ["sh", "-c", f"echo '{HOSTILE}'; exec sleep 1000"]}
    text = yaml.safe_dump(
        {
            "apiVersion": "rorg/v1",
            "kind": "Service",
            "metadata": {"name": "hostile", "description": HOSTILE},
            "spec": spec,
        }
    )
    (robot.tree / "services/hostile.yaml").write_text(text)
    wait_for(lambda: "hostile" in robot.client().status()["services"], 20, "it to be declared")
    robot.client().call("PUT", "/v1/requests/h", {"services": ["hostile"], "reason": HOSTILE})
    watched.page.wait_for_selector(f".facts li:has-text('{HOSTILE}')")
    watched.view("now/hostile")
    watched.page.wait_for_selector(f".log:has-text('{HOSTILE}')")
    watched.page.wait_for_selector(f".drawer p:has-text('{HOSTILE}')")
    watched.view("time")
    watched.page.wait_for_selector(".lanes svg .request")
    assert watched.page.locator("img").count() == 0


@pytest.mark.slow
def test_it_works_in_firefox_too(robot, ui, tmp_path):
    (tmp_path / "firefox").mkdir()
    page = Firefox(tmp_path / "firefox")
    try:
        page.go(ui.address)
        page.wait('.node[aria-label="tour: stopped"]')
        page.run("location.hash = 'now/tour'")
        page.wait(".drawer .buttons button")
        page.run("[...document.querySelectorAll('.drawer button')].find(b => b.textContent === 'Request').click()")
        page.wait("dialog[open] button.primary")
        page.run("document.querySelector('dialog button.primary').click()")
        page.wait('.node[aria-label="localization: ready"]')
        for view, there in (("time", ".lane .bar.ready"), ("time", ".usage canvas"), ("manifests", ".list li")):
            page.run(f"location.hash = '{view}'")
            page.wait(there)
        assert page.complaints == []
    finally:
        page.close()


def test_the_page_says_why_it_cannot_begin(tmp_path):
    done = rorg("ui", "--no-browser", "--state-dir", str(tmp_path), code=3)
    assert "`rorg run`" in done.stderr


def test_rorg_run_serves_it_and_it_ends_with_rorg_however_that_ends(tmp_path, chromium):
    robot = RorgProcess(tmp_path, TOUR, "--ui")
    robot.start()
    log = tmp_path / "rorg.log"
    try:
        address = wait_for(lambda: re.search(r"http://127\S+", log.read_text()), 30, "its address")[0]
        watched = Watched(chromium.new_context(), address)
        watched.page.wait_for_selector(".node")
        port = urlsplit(address).port
        robot.stop(kill=True)
        wait_for(lambda: _refused(port or 0), 20, "the page to end")
    finally:
        robot.close()


def _refused(port: int) -> bool:
    with socket.socket() as tried:
        return tried.connect_ex(("127.0.0.1", port)) != 0


def test_its_own_code_is_small_and_vendored_files_are_as_published():
    """Their hashes, so that nobody changes them unnoticed."""
    import hashlib

    page = Path("rorg/web/page")
    own = [p for p in page.rglob("*") if p.is_file() and "vendor" not in p.parts]
    lines = sum(len(p.read_text().splitlines()) for p in own)
    assert lines <= 2500
    known = json.loads((page / "vendor/hashes.json").read_text())
    there = {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in (page / "vendor").iterdir()}
    assert {name: digest for name, digest in there.items() if name != "hashes.json"} == {
        name: one["sha256"] for name, one in known.items()
    }
    assert "inline" not in (page / "index.html").read_text()
