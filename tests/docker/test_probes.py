"""Readiness and life of real programs: every form of probe, what waits for it, and what a failure brings."""

from __future__ import annotations

import contextlib
import itertools
import os
import socket
import threading
import time
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest
from common import free_port, wait_for
from health_server import health, server, tell
from robots import write_tree

from rorg.core.observed import Container
from rorg.core.ros_parameters import ROLE
from rorg.core.schedule import Target
from rorg.engines.process.engine import ProcessEngine
from rorg.errors import EngineError, Unreachable
from rorg.manifest.load import load
from rorg.model.engines import Capabilities
from rorg.model.probe import Probe
from rorg.probes.answer import YES, Answer, no
from rorg.probes.prober import Prober
from rorg.probes.ros_master import probe as probe_of_ros
from rorg.probes.ros_state import read_state
from rorg.probes.runner import ProbeRunner


@pytest.mark.parametrize("form", ["log", "file", "tcp", "exec"])
def test_a_dependant_waits_until_what_it_needs_is_ready(real_robot, tmp_path, form):
    spec = server(tmp_path, real_robot)
    environment = spec["container"]["environment"]
    probe = {
        "log": {"log": "serving on port [0-9]+"},
        "file": {"file": environment["READY_FILE"]},
        "tcp": {"tcp": int(environment["PORT"])},
        "exec": {"exec": ["python3", "-S", "-c", f"open('{environment['READY_FILE']}')"], "interval": "200ms"},
    }[form]
    real_robot.declare({"server": {**spec, "ready": probe}, "client": {"needs": ["server"]}})
    real_robot.request("client")
    real_robot.wait(
        lambda: (
            "server" in real_robot.active()
            and "server is not ready" in real_robot.waits("client")
            and "of 30 s" in real_robot.waits("client")
        )
    )
    assert "client" not in real_robot.active()
    tell(real_robot, "server", "SIGUSR1")
    real_robot.wait(lambda: "client" in real_robot.active())


def test_a_log_line_of_the_run_before_does_not_count(real_robot, tmp_path):
    real_robot.declare(
        {"server": {**server(tmp_path, real_robot), "ready": {"log": "serving"}}, "client": {"needs": ["server"]}}
    )
    real_robot.request("server")
    real_robot.wait(lambda: "server" in real_robot.active())
    tell(real_robot, "server", "SIGUSR1")
    real_robot.settle()
    before = real_robot.container("server").incarnation
    real_robot.kill("server")
    real_robot.wait(lambda: "server" in real_robot.active() and real_robot.container("server").incarnation != before)
    real_robot.request("client", id="client")
    real_robot.wait(lambda: "no line of its output" in real_robot.waits("client"))
    tell(real_robot, "server", "SIGUSR1")
    real_robot.wait(lambda: "client" in real_robot.active())


def test_the_engines_own_health_check_counts(docker_robot, tmp_path):
    spec = server(tmp_path, docker_robot, ready={"engine": "healthy"})
    ready = spec["container"]["environment"]["READY_FILE"]
    spec["container"]["healthcheck"] = {
        "test": ["CMD", "python3", "-S", "-c", f"open('{ready}')"],
        "interval": "1s",
        "timeout": "5s",
        "retries": 1,
    }
    docker_robot.declare({"server": spec, "client": {"needs": ["server"]}})
    docker_robot.request("client")
    docker_robot.wait(lambda: "the engine says" in docker_robot.waits("client"))
    tell(docker_robot, "server", "SIGUSR1")
    docker_robot.wait(lambda: "client" in docker_robot.active())


def test_a_program_that_hangs_is_restarted(real_robot, tmp_path):
    spec = server(tmp_path, real_robot, always_on=True)
    alive = spec["container"]["environment"]["ALIVE_FILE"]
    real_robot.declare({"server": {**spec, "live": {"file": alive, "interval": "500ms", "failures": 2}}})
    real_robot.wait(lambda: "server" in real_robot.active())
    real_robot.settle()
    before = real_robot.container("server").incarnation
    tell(real_robot, "server", "SIGUSR2")
    real_robot.wait(lambda: "server" in real_robot.active() and real_robot.container("server").incarnation != before)
    assert any("did not answer" in line for line in real_robot.log())
    real_robot.wait(lambda: real_robot.status()["services"]["server"]["crashes"] == 1)


def take_away(robot, container: str) -> bool:
    """Stops and removes a container. Returns whether it is gone: rorg may have started it meanwhile."""
    with contextlib.suppress(EngineError):
        robot.engine.stop(container, "SIGKILL", 5.0)
        robot.engine.remove(container)
    return container not in {c.id for c in robot.engine.list()}


@pytest.mark.slow
@pytest.mark.parametrize(("role", "anew"), [("ready", False), ("live", False), ("ready", True), ("live", True)])
def test_a_program_that_hangs_is_restarted_also_after_a_probe_that_failed(real_robot, tmp_path, role, anew):
    spec = server(tmp_path, real_robot, always_on=True, update={"bake": "200ms"})
    spec["live"] = {"file": spec["container"]["environment"]["ALIVE_FILE"], "interval": "500ms", "failures": 2}
    real_robot.declare({"server": spec})
    real_robot.wait(lambda: real_robot.status().get("runs", {}).get("server", {}).get("baked"))
    if anew:  # somebody removes the container that was proven; the next one is like it
        removed = real_robot.container("server").id
        real_robot.wait(lambda: take_away(real_robot, removed))
        real_robot.wait(lambda: real_robot.status()["runs"]["server"]["well"] not in ("", removed))
    before = real_robot.container("server").incarnation
    wrong = {"tcp": free_port(), "timeout": "1s"} if role == "ready" else {"tcp": free_port(), "interval": "200ms"}
    real_robot.declare({"server": {**spec, role: wrong}})
    real_robot.wait(lambda: real_robot.status()["runs"]["server"].get("quarantined"))
    assert health(real_robot, "server") == "Healthy"
    assert real_robot.container("server").incarnation == before
    tell(real_robot, "server", "SIGUSR2")
    real_robot.wait(lambda: "server" in real_robot.active() and real_robot.container("server").incarnation != before)


def test_what_hangs_again_and_again_is_restarted_with_growing_pauses(tmp_path):
    from robots import VirtualRobot

    robot = VirtualRobot(tmp_path)
    robot.declare({"server": {"always_on": True, "live": {"tcp": 80}}})
    robot.wait(lambda: "server" in robot.active())
    while robot.now() < 60:
        robot.sim.hung |= {c.incarnation for c in robot.containers()}
        robot.wait(lambda: any(c.alive and c.incarnation not in robot.sim.hung for c in robot.containers()), 120)
    starts = [at for at, text in robot.sim.log if text.startswith("> start")]
    pauses = [b - a for a, b in itertools.pairwise(starts)]
    assert pauses == sorted(pauses)
    assert pauses[-1] > 10


class DeafEngine:
    """One that cannot be asked, as during an upgrade of dockerd."""

    capabilities, local = Capabilities(), True

    def exec(self, *args):
        raise Unreachable("ask", "the engine does not answer", "again later")

    inspect = log_since = exec


@pytest.mark.parametrize("form", [("exec", ("true",)), ("engine", "healthy"), ("log", "serving")])
def test_an_engine_that_cannot_be_asked_is_no_failure_of_the_service(form):
    container = Container("c" * 64, "arm", "arm", "running", "2026-01-01T00:00:00Z")
    probe = Probe(*form, interval=0.01, failures=3)
    asked, ask = [], ProbeRunner(DeafEngine(), lambda service: container)
    prober = Prober(time.monotonic, lambda: None, lambda key, target: (asked.append(key), ask(key, target))[1])
    prober.start()
    prober.watch({("arm", "live"): Target(probe, container.incarnation, 0.01)})
    wait_for(lambda: len(asked) > 5)
    found = prober.results()["arm", "live"]
    prober.stop()
    assert (found.failures, found.ok) == (0, False)
    assert "cannot ask: the engine does not answer" in found.message


def test_a_hang_that_passes_while_the_stop_must_wait_is_forgotten(tmp_path):
    from robots import VirtualRobot

    robot = VirtualRobot(tmp_path)
    robot.declare({"arm": {"always_on": True, "live": {"tcp": 80}, "interlock": {"file": "/allow"}}})
    robot.settle()
    before = robot.container("arm").incarnation
    robot.sim.locked, robot.sim.hung = {"arm"}, {before}
    robot.wait(lambda: "interlock" in robot.waits("arm"))
    robot.sim.hung = set()
    robot.wait(lambda: robot.waits("arm") == "")
    robot.sim.locked = set()
    robot.settle()
    assert robot.container("arm").incarnation == before
    assert robot.sim.memory.of("arm").exits == 0


def test_a_log_line_that_is_read_in_halves_matches(tmp_path):
    engine = ProcessEngine("test", tmp_path)
    container = engine.create(
        "x",
        {"image": "x"},
        {"rorg.io/owner": "test", "rorg.io/service": "x", "rorg.io/spec": "", "rorg.io/declared": ""},
    )
    log, run = tmp_path / container / "log", Container(container, "x", "x", "running", "now")
    ask = ProbeRunner(engine, lambda service: run)
    target = Target(Probe("log", "serving on port [0-9]+"), run.incarnation, 1.0)
    log.write_bytes(b"begins\nnow serv")
    assert ask(("x", "ready"), target).message != ""
    log.write_bytes(b"begins\nnow serving on port 80\n")
    assert ask(("x", "ready"), target) == YES


def test_a_file_of_the_run_before_does_not_count(real_robot, tmp_path):
    """A process of this machine leaves its files behind, as a stopped container does."""
    spec = server(tmp_path, real_robot)
    ready = spec["container"]["environment"]["READY_FILE"]
    real_robot.declare({"server": {**spec, "ready": {"file": ready}}, "client": {"needs": ["server"]}})
    real_robot.request("server")
    real_robot.wait(lambda: "server" in real_robot.active())
    tell(real_robot, "server", "SIGUSR1")
    real_robot.wait(lambda: health(real_robot, "server") == "Healthy")
    written = time.monotonic()
    wait_for(lambda: time.monotonic() > written + 0.2, what="clocks tell the two runs apart")
    before = real_robot.container("server").incarnation
    real_robot.kill("server")
    real_robot.wait(lambda: "server" in real_robot.active() and real_robot.container("server").incarnation != before)
    real_robot.request("client", id="client")
    real_robot.wait(lambda: "is older than this run" in real_robot.waits("client"))
    tell(real_robot, "server", "SIGUSR1")
    real_robot.wait(lambda: "client" in real_robot.active())


def test_an_interlock_asked_every_few_seconds_still_allows(tmp_path):
    from robots import RealRobot

    robot = RealRobot(tmp_path, "process", None)
    allow = tmp_path / "allow"
    allow.touch()
    try:
        robot.declare(
            {
                "base": {"ready": {"delay": "1700ms"}},
                "arm": {"needs": ["base"], "interlock": {"file": str(allow), "interval": "3s"}},
            }
        )
        robot.request("arm")
        robot.wait(lambda: "arm" in robot.active())
    finally:
        robot.close()


def test_an_interlock_that_takes_its_time_still_allows(tmp_path):
    """Its answer is too old for a while before the next, equal one comes."""
    answers = []
    prober = Prober(time.monotonic, lambda: answers.append(1), lambda key, target: slowly(0.9))
    prober.start()
    prober.watch({("arm", "interlock"): Target(Probe("http", "x", interval=0.25), "", 0.25)})
    wait_for(lambda: len(answers) >= 3, what="the same answer is news when the one before is too old")
    prober.stop()


def test_time_between_failures_grows_where_a_target_says_so():
    times = []
    prober = Prober(time.monotonic, lambda: None, lambda key, target: (times.append(time.monotonic()), no("x"))[1])
    prober.start()
    prober.watch({("nav", "ros-parameters"): Target(Probe("tcp", "x"), "", 0.02, longest=0.16)})
    wait_for(lambda: len(times) >= 6)
    prober.stop()
    gaps = [after - before for before, after in itertools.pairwise(times)]
    assert all(gap >= least for gap, least in zip(gaps, (0.02, 0.04, 0.08, 0.16, 0.16), strict=False))
    assert Target(Probe("tcp", "x"), "", 10.0).next_after(9) == 10.0, "others are asked as often as ever"


def slowly(seconds: float) -> Answer:
    began = time.monotonic()
    wait_for(lambda: time.monotonic() > began + seconds)
    return YES


def test_a_service_that_lost_its_readiness_is_still_asked_whether_it_lives(tmp_path):
    from robots import VirtualRobot

    robot = VirtualRobot(tmp_path)
    robot.declare({"server": {"always_on": True, "ready": {"tcp": 80, "failures": 2}, "live": {"tcp": 80}}})
    robot.wait(lambda: robot.sim.memory.of("server").ready)
    before = robot.container("server").incarnation
    targets = robot.sim.decision.to_probe
    assert {role for _, role in targets} == {"ready", "live"}
    robot.sim.memory = replace(
        robot.sim.memory, progress={"server": replace(robot.sim.memory.of("server"), ready=False)}
    )
    robot.sim.hung = {before}
    robot.wait(lambda: robot.container("server").incarnation != before, 5)


def test_a_ready_service_can_lose_its_readiness(real_robot, tmp_path):
    port = free_port()
    listener = socket.create_server(("127.0.0.1", port))
    real_robot.declare(
        {"server": {"always_on": True, "ready": {"tcp": port, "failures": 2}}, "client": {"needs": ["server"]}}
    )
    real_robot.wait(lambda: "server" in real_robot.active())
    real_robot.wait(lambda: health(real_robot, "server") == "Healthy")
    listener.close()
    real_robot.wait(lambda: health(real_robot, "server") != "Healthy")
    real_robot.request("client")
    real_robot.wait(lambda: "server is not ready" in real_robot.waits("client"))
    with socket.create_server(("127.0.0.1", port)):
        real_robot.wait(lambda: "client" in real_robot.active())


def test_a_resumed_service_is_probed_again(real_robot, tmp_path):
    port = free_port()
    real_robot.declare(
        {"server": {"ready": {"tcp": port}, "idle": {"action": "pause"}}, "client": {"needs": ["server"]}}
    )
    with socket.create_server(("127.0.0.1", port)):
        real_robot.request("client")
        real_robot.wait(lambda: "client" in real_robot.active())
    real_robot.release()
    real_robot.wait(lambda: real_robot.states()["server"] == "paused")
    real_robot.request("client")
    real_robot.wait(lambda: "server" in real_robot.active() and "server is not ready" in real_robot.waits("client"))
    with socket.create_server(("127.0.0.1", port)):
        real_robot.wait(lambda: "client" in real_robot.active())


def test_nothing_touches_a_driver_against_its_interlock(real_robot, tmp_path):
    allow = tmp_path / "estop-released"
    arm = {"driver": {}, "interlock": {"file": str(allow)}}
    real_robot.declare({"arm": arm, "camera": {}})
    real_robot.request("arm", "camera")
    real_robot.wait(lambda: real_robot.active() == {"camera"} and "interlock" in real_robot.waits("arm"))
    allow.touch()
    real_robot.wait(lambda: "arm" in real_robot.active())
    real_robot.settle()
    before = real_robot.container("arm").incarnation
    allow.unlink()
    wait_for(lambda: ("arm", "interlock") not in real_robot.loop.prober.results())
    real_robot.declare({"arm": {**arm, "container": {"environment": {"SPEED": "2"}}}, "camera": {}})
    real_robot.release()
    real_robot.wait(lambda: "camera" not in real_robot.active() and "interlock" in real_robot.waits("arm"))
    assert before in {c.incarnation for c in real_robot.containers() if c.state == "running"}
    allow.touch()
    real_robot.wait(lambda: "arm" not in real_robot.active())


def test_killed_for_memory_is_told_apart_from_a_crash(docker_robot):
    eat = ["python3", "-S", "-c", "import signal\nsignal.sigtimedwait([34], 0.2)\nx = b'x' * (1 << 28)\nsignal.pause()"]
    docker_robot.declare(
        {
            "eater": {"always_on": True, "command": eat, "container": {"mem_limit": "32Mi", "memswap_limit": "32Mi"}},
            "crasher": {"always_on": True, "command": ["python3", "-S", "-c", "raise SystemExit(3)"]},
        }
    )
    docker_robot.wait(lambda: any("out of memory" in line for line in docker_robot.log()))
    docker_robot.wait(lambda: _stalled(docker_robot, "eater") == "CrashLoop")
    docker_robot.wait(lambda: "out of memory" in _message(docker_robot, "eater"))
    docker_robot.wait(lambda: "exit code 3" in _message(docker_robot, "crasher"))


def _stalled(robot, name: str) -> str:
    conditions = robot.status().get("services", {}).get(name, {}).get("conditions", [])
    return next((c["reason"] for c in conditions if c["type"] == "Stalled"), "")


def _message(robot, name: str) -> str:
    conditions = robot.status().get("services", {}).get(name, {}).get("conditions", [])
    return next((c["message"] for c in conditions if c["type"] == "Stalled"), "")


class Page(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self.send_response(200 if self.path == "/fine" else 503)
        self.end_headers()

    def do_POST(self) -> None:
        self.send_response(200)
        self.end_headers()
        self.wfile.write(b"hello <world")

    def log_message(self, *args) -> None:
        pass


def test_what_answers_no_xml_is_no_ros_master():
    with HTTPServer(("127.0.0.1", 0), Page) as page:
        threading.Thread(target=page.serve_forever, daemon=True).start()
        with pytest.raises(OSError, match="ExpatError"):
            read_state(f"http://127.0.0.1:{page.server_port}")
        page.shutdown()


def test_an_http_probe_wants_2xx_or_3xx(monkeypatch):
    from rorg.probes.ask import ask_host

    with HTTPServer(("127.0.0.1", 0), Page) as page:
        threading.Thread(target=page.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{page.server_port}"
        assert ask_host(Probe("http", f"{url}/fine")) == YES
        assert ask_host(Probe("http", f"{url}/ill")).message == f"{url}/ill answers 503"
        monkeypatch.setenv("http_proxy", f"http://127.0.0.1:{free_port()}")
        assert ask_host(Probe("http", f"{url}/fine")) == YES, "a robot's own programs are behind no proxy"
        page.shutdown()
    assert "refused" in ask_host(Probe("http", f"{url}/fine")).message


def test_a_server_that_does_not_speak_http_has_answered():
    from rorg.probes.ask import ask_host

    with socket.create_server(("127.0.0.1", 0)) as listener:

        def answer() -> None:
            connection, _ = listener.accept()
            connection.recv(1000)
            connection.sendall(b"SSH-2.0-hello\r\n")
            connection.close()

        threading.Thread(target=answer, daemon=True).start()
        assert "BadStatusLine" in ask_host(Probe("http", f"http://127.0.0.1:{listener.getsockname()[1]}")).message


@pytest.mark.slow
def test_300_probed_services_do_not_load_the_machine():
    """One probe each a second for three seconds, over a listener that always answers."""
    woken = []
    with socket.create_server(("127.0.0.1", 0), backlog=500) as listener:
        from rorg.probes.ask import ask_host

        def accept() -> None:
            while True:
                try:
                    listener.accept()[0].close()
                except OSError:
                    return

        threading.Thread(target=accept, daemon=True).start()
        probe = Probe("tcp", f"127.0.0.1:{listener.getsockname()[1]}", interval=1.0, failures=3)
        asked = []
        prober = Prober(
            time.monotonic, lambda: woken.append(1), lambda key, target: (asked.append(key), ask_host(target.probe))[1]
        )
        prober.start()
        prober.watch({(f"s{n}", "live"): Target(probe, "run", 1.0) for n in range(300)})
        began, used = time.monotonic(), os.times()
        wait_for(lambda: len(asked) >= 900)
        now, seconds = os.times(), time.monotonic() - began
        assert all(f.ok for f in prober.results().values())
        prober.stop()
        listener.close()
    assert len(woken) <= 300, "the loop is woken by news only"
    share = (now.user + now.system - used.user - used.system) / seconds
    assert share < 0.5, f"{share:.2f} of a core, the listener's own part included"


@pytest.mark.parametrize("role", ["ready", ROLE])
def test_no_master_is_asked_for_a_program_of_ros_2(role, tmp_path, process_engine):
    """Whoever answers where ROS 1 looks for its master may be another robot's, and it is not even connected to."""
    services = {"talker": {"profile": "ros2", "ready": {"ros_node": "/talker"}, "ros": {"parameters": {"/a/b": 1}}}}
    loaded = load(write_tree(tmp_path / "tree", services))
    assert "ros2-graph-unreported" in {d.code for d in loaded.diagnostics}
    talker = loaded.catalog.services["talker"]
    assert talker.ready.graph == talker.ros.graph == "domain 0"
    probe = talker.ready if role == "ready" else Probe("ros_parameters", "digest", graph=talker.ros.graph)
    container = Container("1", "talker", "talker", "running")
    target = Target(probe, container.incarnation, 1.0, values=talker.ros.values)
    answer = ProbeRunner(process_engine, lambda _: container)(("talker", role), target)
    assert not answer.ok
    assert not answer.asked
    assert "only a running rorg" in answer.message


@pytest.mark.parametrize("kind", ["ros_node", "ros_topic", "ros_service"])
def test_a_master_that_does_not_answer_is_to_blame_itself(kind):
    master = f"http://127.0.0.1:{free_port()}"
    answer = probe_of_ros(kind, "/talker", master)
    assert not answer.ok
    assert answer.message == f"the ROS master {master} does not answer: Connection refused"
