"""What a program is told of readiness is true: of one run, which goes on."""

from __future__ import annotations

import http.client
import json
import random
import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from common import wait_for

SLOW = {
    "command": [
        "python3",
        "-c",
        "import signal, time\nsignal.signal(signal.SIGINT, lambda *_: (time.sleep(2), "
        "exit()))\nprint('up', flush=True)\nwhile True: signal.pause()",
    ],
    "ready": {"log": "up"},
    "container": {"stop_signal": "SIGINT", "stop_grace_period": "10s"},
    "idle": {"action": "stop", "linger": 0},
}
PAUSED = {"idle": {"action": "pause", "linger": 0}}
STOPPED = {"idle": {"action": "stop", "linger": 0}, "container": {"stop_grace_period": "1s"}}


class Raw(http.client.HTTPConnection):
    """The API as it is, without a client that remembers anything."""

    def __init__(self, path: str) -> None:
        super().__init__("rorg", timeout=60)
        self.path = path

    def connect(self) -> None:
        self.sock = socket.socket(socket.AF_UNIX)
        self.sock.settimeout(60)
        self.sock.connect(self.path)

    def ask(self, method: str, path: str, body: dict | None = None, **headers: str) -> tuple[int, dict, dict]:
        """(status, headers, body)."""
        self.request(
            method,
            path,
            json.dumps(body) if body is not None else None,
            {**headers, **({"content-type": "application/json"} if body is not None else {})},
        )
        answer = self.getresponse()
        text = answer.read()
        return answer.status, {k.lower(): v for k, v in answer.getheaders()}, json.loads(text) if text else {}


@pytest.fixture
def robot(real_robot):
    real_robot.with_server = True
    real_robot.declare({"always": {"always_on": True}})
    real_robot.settle()
    return real_robot


def declare(robot, services: dict) -> None:
    robot.declare({"always": {"always_on": True}, **services})
    robot.settle()


def raw(robot) -> Raw:
    return Raw(robot.socket())


def test_no_run_that_is_being_ended_is_called_ready(robot):
    declare(robot, {"slow": SLOW})
    api = raw(robot)
    api.ask("PUT", "/v1/requests/a", {"services": ["slow"]})
    assert api.ask("GET", "/v1/wait?services=slow&timeout=60")[0] == 200
    first = robot.container("slow").incarnation
    api.ask("DELETE", "/v1/requests/a")
    robot.wait(lambda: "slow" in robot.loop.running.memory.in_flight)
    generation = api.ask("PUT", "/v1/requests/b", {"services": ["slow"]})[2]["generation"]
    assert api.ask("GET", f"/v1/services/slow?not_before={generation}")[2]["health"] == "Progressing"
    status, _, told = api.ask("GET", "/v1/wait?services=slow&timeout=60")
    now = robot.container("slow")
    assert status == 200
    assert now.state == "running"
    assert now.incarnation != first
    assert told["services"]["slow"] == {"ready": True, "incarnation": now.incarnation, "reason": ""}


@pytest.mark.slow
def test_what_is_told_ready_runs_and_goes_on_running_while_it_is_requested(robot):
    """Programs that request, look and release back to back, with nothing that lingers."""
    declare(robot, {"cam": PAUSED, "nav": {**STOPPED, "needs": ["loc"]}, "loc": PAUSED})
    wrong, count = [], 25 if robot.kind == "docker" else 80

    def program(number: int) -> None:
        chance, api = random.Random(number), raw(robot)
        for cycle in range(count):
            service = chance.choice(("cam", "nav", "loc"))
            api.ask("PUT", f"/v1/requests/r{number}", {"services": [service]})
            status, _, told = api.ask("GET", f"/v1/wait?services={service}&timeout=60")
            before = {n: robot.container(n) for n in told.get("services", {})}
            time.sleep(chance.choice((0.0, 0.0, 0.005, 0.02)))
            after = {n: robot.container(n) for n in before}
            for name, ready in told.get("services", {}).items():
                states = before[name].state, after[name].state, before[name].incarnation, after[name].incarnation
                if states != ("running", "running", ready["incarnation"], ready["incarnation"]):
                    wrong.append((number, cycle, name, ready, states))
            if status != 200:
                wrong.append((number, cycle, service, status, told))
            api.ask("DELETE", f"/v1/requests/r{number}")

    with ThreadPoolExecutor(3) as pool:
        list(pool.map(program, range(3)))
    assert not wrong


def test_after_a_restart_or_a_change_only_the_new_run_is_ready(robot):
    declare(robot, {"cam": STOPPED})
    api = raw(robot)
    api.ask("PUT", "/v1/requests/a", {"services": ["cam"]})
    api.ask("GET", "/v1/wait?services=cam&timeout=60")
    first = robot.container("cam").incarnation
    status, headers, told = api.ask("POST", "/v1/services/cam/restart")
    assert status == 200
    assert told["generation"] == int(headers["rorg-generation"])
    assert api.ask("GET", "/v1/wait?services=cam&timeout=60")[0] == 200
    second = robot.container("cam")
    assert second.incarnation != first
    assert second.state == "running"

    text = (robot.tree / "services/cam.yaml").read_text()
    base = next(m["digest"] for m in api.ask("GET", "/v1/manifests")[2] if m["name"] == "cam")
    changed = text.replace("metadata:", "metadata:\n  description: changed", 1).replace(
        "stop_grace_period: 1s", "stop_grace_period: 1s\n    environment: {NEW: '1'}"
    )
    assert changed != text
    status, headers, told = api.ask("PUT", "/v1/manifests/Service/cam", {"text": changed, "base": base})
    assert status == 200, told
    assert api.ask("GET", "/v1/wait?services=cam&timeout=60")[0] == 200
    third = robot.container("cam")
    assert third.id != second.id
    assert third.state == "running"


def test_whoever_names_a_change_gets_no_answer_from_before_it(robot):
    declare(robot, {"cam": STOPPED})
    api = raw(robot)
    for round in range(10):
        name = f"extra{round}"
        text = (robot.tree / "services/cam.yaml").read_text().replace("name: cam", f"name: {name}")
        status, headers, told = api.ask("PUT", f"/v1/manifests/Service/{name}", {"text": text, "base": None})
        assert status == 200, told
        known = {"rorg-not-before": headers["rorg-generation"]}
        assert api.ask("GET", f"/v1/services/{name}", **known)[0] == 200
        status, headers, told = api.ask("PUT", "/v1/requests/a", {"services": [name]}, **known)
        assert status == 200, told
        asked = api.ask("GET", f"/v1/services/{name}?not_before={headers['rorg-generation']}")[2]
        assert asked["wanted"]
    assert api.ask("GET", "/v1/services/cam", **{"rorg-not-before": "1"})[0] == 200, "of an earlier rorg"
    assert api.ask("GET", "/v1/services/cam", **{"rorg-not-before": "9" * 17})[0] == 200, "the clock was set back"
    assert api.ask("GET", "/v1/services/cam", **{"rorg-not-before": "soon"})[0] == 422


def test_readiness_is_asked_for_again_by_whoever_waits(robot, tmp_path):
    """A probe that said yes long ago, for somebody else, is no answer now."""
    yes = tmp_path / "yes" if robot.kind == "process" else "/yes"
    check = ["python3", "-c", f"import os, sys; sys.exit(not os.path.exists('{yes}'))"]
    declare(robot, {"cam": {**STOPPED, "ready": {"exec": check, "interval": "50ms"}}})
    api = raw(robot)
    api.ask("PUT", "/v1/requests/a", {"services": ["cam"]})
    robot.wait(lambda: "cam" in robot.active())

    def answer(what: str) -> None:
        code, said = robot.engine.exec(robot.container("cam").id, ["python3", "-c", f"import os; {what}"], 10)
        assert code == 0, said

    answer(f"open('{yes}', 'w')")
    assert api.ask("GET", "/v1/wait?services=cam&timeout=60")[0] == 200
    answer(f"os.unlink('{yes}')")
    status, _, told = api.ask("GET", "/v1/wait?services=cam&timeout=1")
    assert status == 504
    assert not told["services"]["cam"]["ready"]
    answer(f"open('{yes}', 'w')")
    assert api.ask("GET", "/v1/wait?services=cam&timeout=60")[0] == 200


def test_who_waits_while_rorg_is_stopped_is_told_to_come_again(robot):
    declare(robot, {"cam": STOPPED})
    robot.hold = raw(robot).ask("PUT", "/v1/holds/cam", {"duration": "1h"})
    answers: list[tuple[int, dict, dict]] = []
    waiting = [
        threading.Thread(target=lambda: answers.append(raw(robot).ask("GET", "/v1/wait?services=cam&timeout=60")))
        for _ in range(5)
    ]
    raw(robot).ask("DELETE", "/v1/holds/cam")
    for thread in waiting:
        thread.start()
    wait_for(lambda: len(robot.loop.questions) == 5)
    robot.server.end()
    for thread in waiting:
        thread.join(60)
    assert [(status, headers.get("retry-after"), told["code"]) for status, headers, told in answers] == [
        (503, "1", "busy")
    ] * 5
    assert raw(robot).ask("PUT", "/v1/requests/late", {"services": ["cam"]})[0] == 503
    robot.server.operations.ending = False


def test_a_question_without_time_is_answered_from_the_last_probe_of_this_run(robot, tmp_path):
    """Yes as long as the service is held and well, whether its probe goes on or ended with its first yes."""
    yes = tmp_path / "yes" if robot.kind == "process" else "/yes"
    check = {"file": str(yes), "interval": "50ms"}
    begin = ["python3", "-c", f"import signal\nopen('{yes}', 'w').close()\nsignal.pause()"]
    service = {**STOPPED, "command": begin}
    cam = {**service, "ready": {**check, "failures": 1000}}
    declare(robot, {"idle": STOPPED, "cam": cam, "arm": {**service, "ready": check, "needs": ["cam"]}})
    api, question = raw(robot), "/v1/wait?services=arm&timeout=0"
    assert api.ask("GET", question)[0] == 504, "nobody requests it"
    api.ask("PUT", "/v1/requests/a", {"services": ["arm"]})
    assert api.ask("GET", "/v1/wait?services=arm&timeout=60")[0] == 200
    runs = {name: robot.container(name).incarnation for name in ("arm", "cam")}
    for _ in range(20):
        status, _, told = api.ask("GET", question)
        assert status == 200, told
        assert {name: one["incarnation"] for name, one in told["services"].items()} == runs
    wait_for(lambda: robot.loop.clock() > robot.loop.running.memory.of("arm").answered + 0.05, what="its answer is old")
    status, _, told = api.ask("GET", "/v1/wait?services=arm&services=idle&timeout=0")
    assert status == 504, "nobody requests all of them"
    assert {name: one["ready"] for name, one in told["services"].items()} == {"arm": True, "cam": True, "idle": False}

    def make(name: str, what: str) -> None:
        code, said = robot.engine.exec(robot.container(name).id, ["python3", "-c", f"import os; {what}"], 10)
        assert code == 0, said

    for name in {"arm", "cam"} if robot.kind == "docker" else {"arm"}:  # processes share the file
        make(name, f"os.unlink('{yes}')")
        # Processes share the file, and the other one may be asked first.
        wait_for(lambda n=name: not api.ask("GET", question)[2]["services"][n]["ready"], what="its last probe says no")
        for _ in range(5):
            status, _, told = api.ask("GET", question)
            assert status == 504
            assert "No such file" in told["services"][name]["reason"]
        make(name, f"open('{yes}', 'w')")
        wait_for(lambda: api.ask("GET", question)[0] == 200, what="the last probe says yes")


def test_a_question_without_time_does_not_wait_for_a_probe_that_hangs(robot, tmp_path):
    hang = tmp_path / "hang" if robot.kind == "process" else "/hang"
    check = ["python3", "-c", f"import os, time\nif os.path.exists('{hang}'): time.sleep(600)"]
    declare(robot, {"cam": {**STOPPED, "ready": {"exec": check, "interval": "50ms"}}})
    api = raw(robot)
    api.ask("PUT", "/v1/requests/a", {"services": ["cam"]})
    assert api.ask("GET", "/v1/wait?services=cam&timeout=60")[0] == 200
    code, said = robot.engine.exec(robot.container("cam").id, ["python3", "-c", f"open('{hang}', 'w')"], 10)
    assert code == 0, said
    answered = robot.loop.running.memory.of("cam").answered
    wait_for(lambda: robot.loop.clock() > answered + 0.05)
    began = time.monotonic()
    status, _, told = api.ask("GET", "/v1/wait?services=cam&timeout=0")
    assert status == 504
    assert told["services"]["cam"]["reason"] == "its probe has not answered yet"
    assert time.monotonic() - began < 9, "one attempt of a probe may take ten seconds"


def test_a_wait_goes_on_while_a_service_that_kept_crashing_is_tried_again(robot, tmp_path):
    """It was said to be hopeless, with the reason `Probing`."""
    folder = tmp_path / "runs"
    folder.mkdir(mode=0o777)
    runs = folder / "runs"
    program = f"open({str(runs)!r}, 'a').write('x')\nimport os, signal, sys\n"
    program += f"sys.exit(3) if os.path.getsize({str(runs)!r}) < 4 else signal.pause()"
    again = {
        "command": ["python3", "-c", program],
        "ready": {"file": str(folder / "up"), "interval": "100ms"},
        "container": {"volumes": [f"{folder}:{folder}"]} if robot.kind == "docker" else {},
    }
    robot.declare({"always": {"always_on": True}, "arm": again})
    robot.request("arm")
    robot.wait(lambda: "arm" in robot.states())
    robot.wait(lambda: "exit code 3" in robot.client().readiness("arm")["arm"]["reason"])
    robot.wait(lambda: any("arm is stalled" in line for line in robot.log()))
    robot.wait(lambda: robot.states()["arm"] == "running" and runs.read_text().count("x") == 4)
    threading.Timer(1.0, (folder / "up").touch).start()
    assert robot.client().wait("arm", timeout=30)["arm"]["ready"]
