"""Notifications: to real commands and real HTTP servers, from a real loop over the process engine."""

from __future__ import annotations

import json
import os
import ssl
import subprocess
import sys
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest
import yaml
from common import free_port, wait_for
from robots import RealRobot, write_tree
from rorg_client.ros.notifications import serve
from tools import tool

from rorg.core.masking import Masker
from rorg.daemon import notifier
from rorg.daemon.notices import KINDS, Notices, body, due, notification
from rorg.daemon.recorder import Recorder
from rorg.host import bounded_http
from rorg.host.clock import wall_clock
from rorg.host.delivery import Undelivered, post, run
from rorg.manifest.load import load
from rorg.manifest.notify import Notify
from rorg.model.policy import NOTIFY_FIELDS, NOTIFY_KINDS, NotifyTarget, Webhook
from rorg.store.state_dir import StateDir

CAMERA = {"camera": {}, "nav": {"needs": ["camera"]}}


class Receiver:
    """An HTTP server that keeps what is posted. `answer`: its status; None hangs until the end."""

    def __init__(self, answer: int | None = 200, context: ssl.SSLContext | None = None) -> None:
        self.answer, self.got, self.over = answer, [], threading.Event()
        receiver = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self):
                text = self.rfile.read(int(self.headers["Content-Length"])).decode()
                receiver.got.append((self.path, dict(self.headers), text))
                if receiver.answer is None:
                    receiver.over.wait(60)
                self.send_response(receiver.answer or 200)
                self.send_header("Location", "/elsewhere")
                self.end_headers()

            def log_message(self, *_):
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        if context:
            self.server.socket = context.wrap_socket(self.server.socket, server_side=True)
        self.url = f"http{'s' * bool(context)}://127.0.0.1:{self.server.server_port}/hook-s3cr3t"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def json(self) -> list[dict]:
        return [json.loads(text) for _, _, text in self.got]

    def close(self) -> None:
        self.over.set()
        self.server.shutdown()
        self.server.server_close()


@pytest.fixture
def receiver():
    made = []

    def make(*args) -> Receiver:
        made.append(Receiver(*args))
        return made[-1]

    yield make
    for each in made:
        each.close()


@pytest.fixture
def robot(tmp_path, monkeypatch):
    monkeypatch.setattr(notifier, "PAUSES", (0.05, 0.05))
    found = RealRobot(tmp_path, "process", None, with_server=True)
    yield found
    found.close()


def policy(*targets: dict, **more) -> dict:
    return {"policies": {"robot": {"notify": list(targets), **more}}}


def lose(robot: RealRobot) -> None:
    """Kill a service that a live request uses."""
    before = robot.container("camera").incarnation
    robot.kill("camera")
    robot.wait(lambda: robot.container("camera").incarnation != before and "camera" in robot.active())
    robot.settle()


def views(robot: RealRobot) -> dict[str, dict]:
    return {target["name"]: target for target in robot.client().status()["notify"]}


def test_a_loss_is_posted_and_handed_to_a_command(robot, receiver, tmp_path):
    hook, told = receiver(), tmp_path / "told"
    script = f"cat > {told}.new; env | grep RORG_ > {told}.env; env | cut -d= -f1 > {told}.names; mv {told}.new {told}"
    os.environ["RORG_TEST_PASSWORD"] = "hunter2"
    try:
        robot.declare(
            CAMERA,
            **policy(
                {"name": "hook", "webhook": {"url": hook.url}, "on": ["lost"]},
                {"name": "siren", "command": ["sh", "-c", script], "on": ["lost"]},
                {"name": "other", "webhook": {"url": hook.url}, "on": ["unplugged"]},
            ),
        )
        robot.request("nav")
        robot.settle()
        lose(robot)
        robot.wait(lambda: hook.got and told.exists())
    finally:
        del os.environ["RORG_TEST_PASSWORD"]
    [(path, headers, _)] = hook.got
    [one] = hook.json()
    assert path == "/hook-s3cr3t"
    assert headers["Content-Type"] == "application/json"
    assert tuple(one) == NOTIFY_FIELDS
    assert (one["kind"], one["event"], one["service"], one["cause"]) == ("lost", "lost", "camera", "crashed")
    assert "camera is lost to developer/test" in one["message"]
    assert one["robot"] == os.uname().nodename
    assert json.loads(told.read_text()) == one
    assert "RORG_NOTIFY_SERVICE=camera" in (env := (tmp_path / "told.env").read_text())
    assert "RORG_NOTIFY_KIND=lost" in env
    assert "RORG_TEST_PASSWORD" not in (tmp_path / "told.names").read_text()
    robot.wait(lambda: views(robot)["hook"]["sent"] == 1)
    assert views(robot)["other"] == {"name": "other", "error": "", "sent": 0, "lost": 0}


def test_a_failed_change_is_told_as_quarantined_and_failed(robot, receiver):
    hook = receiver()
    target = {"name": "hook", "webhook": {"url": hook.url, "template": {"text": "{kind} {service}"}}}
    kinds = policy(target, updates={"bake": "100ms"})
    robot.declare({"camera": {"always_on": True}}, **kinds)
    robot.settle()
    robot.declare({"camera": {"always_on": True, "command": ["sh", "-c", "exit 3"]}}, **kinds)
    robot.wait(lambda: len(hook.got) >= 2)
    assert {one["text"] for one in hook.json()} == {"quarantined camera", "failed "}
    [event] = [e for e in robot.client().events(tail=500) if e["kind"] == "revision-failed"]
    assert event["revision"] == 2
    assert "camera" in event["message"]


@pytest.mark.slow
def test_targets_come_change_and_go_while_rorg_runs(robot, receiver):
    first, second = receiver(), receiver()
    robot.declare(CAMERA)
    robot.request("nav")
    robot.settle()
    lose(robot)
    robot.declare(CAMERA, **policy({"name": "hook", "webhook": {"url": first.url}, "every": 0, "on": ["lost"]}))
    robot.wait(lambda: "hook" in views(robot))
    lose(robot)
    robot.wait(lambda: first.got)
    assert len(first.got) == 1, "what came before it is not told"
    robot.declare(CAMERA, **policy({"name": "hook", "webhook": {"url": second.url}, "every": 0, "on": ["lost"]}))
    robot.wait(lambda: views(robot)["hook"]["sent"] == 0)
    lose(robot)
    robot.wait(lambda: second.got)
    robot.declare(CAMERA)
    robot.wait(lambda: not views(robot))
    lose(robot)
    time.sleep(0.3)
    assert (len(first.got), len(second.got)) == (1, 1)
    names = {t.name for t in threading.enumerate() if t.name.startswith("notify-") and t.is_alive()}
    wait_for(lambda: not {t.name for t in threading.enumerate() if t.name.startswith("notify-")}, 5, f"{names} end")


@pytest.mark.slow
def test_a_receiver_that_hangs_or_fails_delays_nobody_and_is_told_once(robot, receiver):
    hanging, failing, good = receiver(None), receiver(500), receiver()
    refusing = f"http://127.0.0.1:{free_port()}/hook-s3cr3t"
    common = {"on": ["lost"], "every": 0, "timeout": "300ms"}
    urls = {"hanging": hanging.url, "failing": failing.url, "refusing": refusing, "good": good.url}
    targets = [{"name": name, "webhook": {"url": url}, **common} for name, url in urls.items()]
    targets += [{"name": "sleeping", "command": ["sleep", "60"], **common}]
    targets += [{"name": "missing", "command": ["/no/such/command", "--token", "s3cr3t"], **common}]
    robot.declare(CAMERA, **policy(*targets))
    robot.request("nav")
    robot.settle()
    for count in (1, 2):
        began = time.monotonic()
        lose(robot)
        robot.wait(lambda count=count: len(good.got) == count)
        assert time.monotonic() - began < 10
    bad = urls.keys() - {"good"} | {"sleeping", "missing"}
    robot.wait(lambda: all(views(robot)[name]["lost"] == 2 for name in bad))
    assert len(failing.got) == 4, "three attempts, then one while it fails"
    failures = [e for e in robot.client().events(tail=500) if e["kind"] == "notify-failed"]
    assert len(failures) == len(bad), "each is told once"
    text = "\n".join(robot.log())
    assert "cannot notify failing: 127.0.0.1 answers 500" in text
    assert "cannot notify refusing: 127.0.0.1: Connection refused" in text
    assert "cannot notify missing: /no/such/command: No such file or directory" in text
    assert "cannot notify sleeping: sleep: no end within 0.3 s" in text
    assert "s3cr3t" not in text + json.dumps(robot.client().status()["notify"]) + json.dumps(failures)
    doctor = subprocess.run(
        [sys.executable, "-m", "rorg", "doctor", "--state-dir", robot.state.path, "--engine", "process", "-o", "json"],
        capture_output=True, text=True,
    )  # fmt: skip
    checks = {c["check"]: c for c in json.loads(doctor.stdout)}
    assert checks["notify failing"]["status"] == "warning"
    assert checks["notify good"]["status"] == "ok"
    failing.answer = 200
    lose(robot)
    robot.wait(lambda: not views(robot)["failing"]["error"])
    assert any("failing receives notifications again; 2 notifications did not reach it" in line for line in robot.log())


def test_rorg_stops_beside_a_target_that_hangs(robot, receiver):
    hanging = receiver(None)
    common = {"on": ["lost"], "timeout": "60s"}
    robot.declare(
        CAMERA,
        **policy(
            {"name": "hanging", "webhook": {"url": hanging.url}, **common},
            {"name": "sleeping", "command": ["sleep", "4321"], **common},
        ),
    )
    robot.request("nav")
    robot.settle()
    lose(robot)
    robot.wait(lambda: hanging.got and sleepers())
    began = time.monotonic()
    robot.stop()
    assert time.monotonic() - began < 8
    wait_for(lambda: not sleepers(), 5, "the command is ended")
    assert not any("cannot notify" in line for line in robot.log()), "an end of rorg is no failure of the target"


def sleepers() -> list[str]:
    found = []
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{pid}/cmdline", "rb") as file:
                found += [pid] if file.read() == b"sleep\x004321\x00" else []
        except OSError:
            continue
    return found


def test_headers_and_url_come_from_files(robot, receiver, tmp_path):
    hook = receiver()
    (tmp_path / "url").write_text(hook.url + "\n")
    (tmp_path / "headers").write_text("# ours\nAuthorization: Bearer t0p-s3cr3t\n\nTitle: nora\n")
    webhook = {"url_file": str(tmp_path / "url"), "headers_file": str(tmp_path / "headers"), "template": "{message}"}
    robot.declare(CAMERA, **policy({"name": "hook", "webhook": webhook, "on": ["lost"]}))
    robot.request("nav")
    robot.settle()
    lose(robot)
    robot.wait(lambda: hook.got)
    [(_, headers, text)] = hook.got
    assert (headers["Authorization"], headers["Title"]) == ("Bearer t0p-s3cr3t", "nora")
    assert headers["Content-Type"] == "text/plain; charset=utf-8"
    assert text.startswith("camera is lost to")
    assert "s3cr3t" not in "\n".join(robot.log()) + json.dumps(robot.client().status())


def test_the_bridge_of_ros_publishes_what_is_posted_to_it(robot):
    published = []
    server = serve(0, published.append)
    url = f"http://127.0.0.1:{server.server_port}/"
    try:
        robot.declare(CAMERA, **policy({"name": "ros", "webhook": {"url": url}, "on": ["lost"]}))
        robot.request("nav")
        robot.settle()
        lose(robot)
        robot.wait(lambda: published)
        assert json.loads(published[0])["service"] == "camera"
        for text in (b"[]", b"{", b"1" * (1 << 17)):
            with pytest.raises(Undelivered):
                post(url, text, {}, 5)
        assert len(published) == 1
    finally:
        server.shutdown()
        server.server_close()


def test_what_gathers_for_a_dead_receiver_does_not_hold_up_what_comes_next(tmp_path, receiver, monkeypatch):
    monkeypatch.setattr(notifier, "PAUSES", (0.01, 0.01))
    failing = receiver(500)
    recorder = Recorder(StateDir(tmp_path / "state").prepare(), lambda _: None, wall_clock, Masker())
    for name in ("camera", "arm", "base"):
        recorder.event("unplugged", f"{name}: its device is missing", service=name)
    target = NotifyTarget("hook", NOTIFY_KINDS, webhook=Webhook(failing.url), every=10.0, timeout=5.0)
    sender = notifier.Sender(target, 0, lambda: "nora", recorder, lambda: None)
    sender.thread.start()
    wait_for(lambda: sender.lost == 3, 10)
    assert [one["service"] for one in failing.json()] == ["camera"] * 3
    failing.answer = 400
    recorder.event("lost", "arm is lost", service="arm", cause="crashed")
    recorder.event("lost", "base is lost", service="base", cause="crashed")
    sender.woken.set()
    wait_for(lambda: sender.lost == 5, 10)
    assert [one["service"] for one in failing.json()[3:]] == ["arm", "base"]
    sender.end()
    sender.thread.join(5)
    recorder.history.close()


# -- one delivery ----------------------------------------------------------------------------------------------


def test_a_redirect_is_not_followed(receiver):
    hook = receiver(302)
    with pytest.raises(Undelivered, match=r"127\.0\.0\.1 answers 302"):
        post(hook.url, b"x", {}, 5)
    assert len(hook.got) == 1


def test_tls_with_a_known_authority_only(receiver, tmp_path, monkeypatch):
    key, certificate = tmp_path / "key.pem", tmp_path / "cert.pem"
    subprocess.run(
        [tool("openssl"), "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", "/CN=nora",
         "-addext", "subjectAltName=IP:127.0.0.1", "-keyout", key, "-out", certificate],
        check=True, capture_output=True,
    )  # fmt: skip
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)
    hook = receiver(200, context)
    bounded_http._context.cache_clear()
    with pytest.raises(Undelivered, match="certificate verify failed"):
        post(hook.url, b"x", {}, 5)
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
    bounded_http._context.cache_clear()
    try:
        post(hook.url, b"x", {}, 5)
    finally:
        bounded_http._context.cache_clear()
    assert [text for _, _, text in hook.got] == ["x"]


def test_a_command_is_ended_with_everything_it_started_and_its_output_is_not_read():
    began = time.monotonic()
    with pytest.raises(Undelivered, match=r"sh: no end within 0\.3 s"):
        run(["sh", "-c", "yes & sleep 4322 & wait"], b"", {}, 0.3, threading.Event())
    assert time.monotonic() - began < 5
    with pytest.raises(Undelivered, match=r"^sh exited with code 7$"):
        run(["sh", "-c", "echo s3cr3t >&2; exit 7"], b"", {"ODD": "a\0\ud800b"}, 5, threading.Event())


# -- which, and when -------------------------------------------------------------------------------------------


def entry(seq: int, kind: str = "lost", service: str = "camera", **more) -> dict:
    return {
        "seq": seq,
        "at": f"2026-01-01T00:00:{seq:02}Z",
        "kind": kind,
        "message": f"entry {seq}",
        "service": service,
        **more,
    }


ALL = NotifyTarget("all", NOTIFY_KINDS, every=10.0)


def test_one_of_a_kind_and_service_in_a_time_and_the_newest_after_it():
    state, found = due(Notices(), [entry(1), entry(2), entry(3), entry(4, service="nav")], ALL, "nora", 100.0)
    assert [(n.seq, n.suppressed) for n in found] == [(1, 0), (4, 0)]
    assert state.next == 110.0
    state, found = due(state, [entry(5, "unplugged")], ALL, "nora", 105.0)
    assert [n.kind for n in found] == ["unplugged"], "another kind has a time of its own"
    state, found = due(state, [], ALL, "nora", 110.0)
    assert [(n.seq, n.suppressed) for n in found] == [(3, 1)]
    state, found = due(state, [entry(6)], ALL, "nora", 111.0)
    assert not found
    assert state.next == 120.0
    state, found = due(state, [], ALL, "nora", 1000.0)
    assert [n.seq for n in found] == [6]
    assert due(state, [], ALL, "nora", 2000.0)[0] == Notices(), "nothing is kept for ever"


def test_only_the_chosen_kinds_and_no_loss_that_was_ordered():
    told = [entry(1, kind) for kind in (*KINDS, "crashed", "notify-failed")]
    _, found = due(Notices(), told, NotifyTarget("one", ("pressure",)), "nora", 0.0)
    assert [n.kind for n in found] == ["pressure"]
    assert notification(entry(1, cause="held"), "nora") is None
    assert notification(entry(1, cause="crashed"), "nora").cause == "crashed"
    assert set(KINDS.values()) == set(NOTIFY_KINDS)
    assert tuple(Notify.model_fields["on"].get_default(call_default_factory=True)) == NOTIFY_KINDS


def test_a_template_is_filled_without_breaking_its_json():
    one = notification(entry(1, message='it says "no" {service}\n'), "nora")
    text, media = body(one, {"text": "{robot}: {message}", "tags": ["{kind}"], "priority": 4})
    assert json.loads(text) == {"text": 'nora: it says "no" {service}\n', "tags": ["lost"], "priority": 4}
    assert media == "application/json"
    assert body(one, "{kind} of {service} {other}")[0] == b"lost of camera {other}"


@pytest.mark.parametrize(
    ("target", "place", "why"),
    [
        ({"name": "a", "webhook": {"url": "ftp://host/x"}}, (8, 14), "must be a URL such as https://"),
        ({"name": "a", "webhook": {"url": "https://user:pw@host/x"}}, (8, 14), "must not hold a password"),
        ({"name": "a", "command": ["true"], "on": ["lost", "crashed"]}, (11, 9), "should be 'lost', 'quarantined'"),
        (
            {"name": "a", "webhook": {"url": "http://h/", "template": "{msg}"}},
            (9, 19),
            "unknown field '{msg}'; the fields are robot",
        ),
        (
            {"name": "a", "webhook": {"url": "http://h/", "template": '{"text": "{message}"}'}},
            (9, 19),
            "write a mapping",
        ),
        ({"name": "a"}, (6, 7), "exactly one of command, webhook must be given"),
        ({"name": "a", "command": []}, (7, 16), "at least 1"),
    ],
)
def test_mistakes_are_told_with_their_place(tmp_path, target, place, why):
    write_tree(tmp_path, {"camera": {}})
    (tmp_path / "policies/robot.yaml").write_text(
        "apiVersion: rorg/v1\nkind: Policy\nmetadata: {name: robot}\nspec:\n  notify:\n"
        + "".join(f"    {line}\n" for line in yaml.dump([target], sort_keys=False, indent=2).splitlines())
    )
    [error] = load(tmp_path).errors
    assert why in str(error), error
    assert (error.where.line, error.where.column) == place, (error, (tmp_path / "policies/robot.yaml").read_text())


def test_two_targets_have_two_names(tmp_path):
    target = {"name": "a", "command": ["true"]}
    write_tree(tmp_path, {"camera": {}}, **policy(target, target))
    assert any("the name 'a' is used twice" in str(e) for e in load(tmp_path).errors)


def test_a_policy_without_targets_keeps_its_fingerprint(tmp_path):
    write_tree(tmp_path, {"camera": {}}, policies={"robot": {}})
    before = load(tmp_path).catalog.fingerprint
    write_tree(tmp_path, {"camera": {}}, **policy())
    assert load(tmp_path).catalog.fingerprint == before
    write_tree(tmp_path, {"camera": {}}, **policy({"name": "a", "command": ["true"]}))
    assert load(tmp_path).catalog.fingerprint != before
