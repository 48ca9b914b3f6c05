"""What services print, of several at once: each line once, whatever becomes of their containers."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from common import wait_for
from robots import RealRobot

from rorg.core.observed import Container
from rorg.engines.log_lines import LogLine
from rorg.engines.logs import Asked, Entries, gather
from rorg.engines.process.log import PIECE, read_lines
from rorg.engines.protocol import Engine
from rorg.host.clock import process_start
from rorg.model.engines import ENGINES
from rorg.model.units import nano_stamp, stamp

COUNTS = """
import pathlib, signal, sys, time
name, file = sys.argv[1], pathlib.Path(sys.argv[2])
while True:
    signal.pthread_sigmask(signal.SIG_BLOCK, (2, 15))
    number = int(file.read_text()) + 1 if file.exists() else 1
    file.write_text(str(number))
    sys.stdout.write(f"{name} {number}\\n")  # in one piece: Podman makes two lines of two pieces
    sys.stdout.flush()
    signal.pthread_sigmask(signal.SIG_UNBLOCK, (2, 15))
    time.sleep(0.02)
"""
"""A program whose lines count on from run to run; no stop comes between a number and its line."""


def counting(name: str, folder: Path, **more: object) -> dict:
    return {"command": ["python3", "-S", "-c", COUNTS, name, str(folder / name)], "always_on": True, **more}


@pytest.fixture
def robot(tmp_path):
    found = RealRobot(tmp_path, "process", None, with_server=True)
    folder = tmp_path / "counts"
    folder.mkdir()
    services = {name: counting(name, folder) for name in ("camera", "arm")}
    services["greeter"] = {"command": ["sh", "-c", "echo hello; echo there; exec sleep 600"], "always_on": True}
    services["waiting"] = {"command": ["sh", "-c", "echo come at last; exec sleep 600"]}
    services["stub"] = {"type": "meta"}
    found.declare(services, groups={"seeing": {"services": ["camera", "greeter"]}})
    found.wait(lambda: found.active() >= {"camera", "arm", "greeter"})
    found.settle()
    yield found
    found.close()


def rorg(robot: RealRobot, *words: str, **more: object) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "rorg", "logs", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        env={**os.environ, "RORG_STATE_DIR": str(robot.state.path), "RORG_ENGINE": robot.kind},
        **more,
    )


def said(robot: RealRobot, *words: str, code: int = 0) -> str:
    process = rorg(robot, *words)
    out, err = process.communicate(timeout=60)
    assert process.returncode == code, err
    return (out or err).decode()


class Followed:
    """`rorg logs -f`, whose lines are kept as they come."""

    def __init__(self, robot: RealRobot, *words: str) -> None:
        self.process, self.lines = rorg(robot, "-f", *words), []
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for line in self.process.stdout:
            self.lines.append(line.decode().rstrip("\n"))

    def numbers(self, name: str) -> list[int]:
        found = (re.fullmatch(rf"(?:{name} *\| )?{name} (\d+)", line) for line in tuple(self.lines))
        return [int(match[1]) for match in found if match]

    def end(self, how: int = signal.SIGINT) -> int:
        self.process.send_signal(how)
        return self.process.wait(30)


@pytest.mark.slow
def test_lines_of_one_service_are_as_it_wrote_them(robot):
    assert said(robot, "greeter") == "hello\nthere\n"
    assert said(robot, "greeter", "-n", "1") == "there\n"
    assert said(robot, "greeter", "--tail", "0") == ""


@pytest.mark.slow
def test_lines_of_several_have_their_services_in_front(robot):
    assert said(robot, "seeing", "-n", "1").splitlines()[-1] == "greeter | there"
    assert re.fullmatch(r"camera  \| camera \d+", said(robot, "seeing", "-n", "1").splitlines()[0])
    entry = json.loads(said(robot, "greeter", "-n", "1", "-o", "json"))
    assert entry == {"service": "greeter", "time": None, "text": "there"}


@pytest.mark.slow
def test_bytes_that_are_no_text_arrive_as_they_are(robot):
    log = robot.engine.records.log(robot.container("greeter").id)
    with log.open("ab") as file:
        file.write(b"\xff\xfe\n")
    process = rorg(robot, "greeter", "-n", "1")
    assert process.communicate(timeout=60)[0] == b"\xff\xfe\n"


@pytest.mark.slow
@pytest.mark.parametrize("running", [True, False], ids=["served", "alone"])
def test_the_same_is_said_with_a_running_rorg_and_without(robot, running):
    if not running:
        robot.stop()
    assert said(robot, "seeing", "-n", "1").splitlines()[-1] == "greeter | there"
    assert "keeps no times" in said(robot, "greeter", "--since", "10m", code=2)
    assert "is not a time" in said(robot, "greeter", "--since", "soon", code=2)
    assert "has no container" in said(robot, "stub", code=2)
    assert "no such service" in said(robot, "greter", code=2)


@pytest.mark.slow
def test_following_tells_every_line_once_over_restarts_and_replacement(robot, tmp_path):
    followed = Followed(robot, "camera", "arm")
    wait_for(lambda: followed.numbers("camera") and followed.numbers("arm"))
    first = robot.container("camera")
    robot.client().restart("camera")
    wait_for(lambda: robot.container("camera").incarnation != first.incarnation and robot.container("camera").alive)
    at = followed.numbers("camera")[-1]
    wait_for(lambda: followed.numbers("camera")[-1] > at + 20)
    changed = {**services_of(robot)["camera"], "container": {"environment": {"A": "1"}}}
    robot.declare({**services_of(robot), "camera": changed})
    wait_for(lambda: robot.container("camera").id != first.id and robot.container("camera").state == "running")
    at = followed.numbers("camera")[-1]
    wait_for(lambda: followed.numbers("camera")[-1] > at + 20)
    each_line_once(followed)


def each_line_once(followed) -> None:
    """At its end, of both services."""
    assert followed.end() in (0, 130)
    for name in ("camera", "arm"):
        numbers = followed.numbers(name)
        assert numbers == list(range(numbers[0], numbers[-1] + 1))


def services_of(robot: RealRobot) -> dict:
    import yaml

    return {p.stem: yaml.safe_load(p.read_text())["spec"] for p in (robot.tree / "services").glob("*.yaml")}


def test_following_goes_on_when_another_rorg_runs(robot):
    followed = Followed(robot, "camera", "-n", "0")
    wait_for(lambda: followed.numbers("camera"))
    robot.stop()
    robot.start()
    at = followed.numbers("camera")[-1]
    wait_for(lambda: followed.numbers("camera")[-1] > at + 20)
    assert followed.end() in (0, 130)
    numbers = followed.numbers("camera")
    assert numbers == list(range(numbers[0], numbers[-1] + 1))


def test_following_waits_for_a_service_that_has_no_container_yet(robot):
    followed = Followed(robot, "waiting")
    robot.client().request("waiting", id="test", ttl=None)
    wait_for(lambda: followed.lines == ["come at last"])
    assert followed.end() in (0, 130)


def test_lines_that_come_have_the_time_at_which_they_were_seen(robot):
    followed = Followed(robot, "camera", "-n", "1", "-t")
    wait_for(lambda: len(followed.lines) > 3)
    assert followed.end() in (0, 130)
    assert re.fullmatch(r"-  +camera \d+", followed.lines[0])
    assert re.match(rf"{time.gmtime().tm_year}-\d\d-\d\dT[\d:]+\.\d{{9}}Z camera \d+", followed.lines[-1])


def test_nothing_is_read_when_nobody_listens(robot):
    process = rorg(robot, "-f", "camera", "arm")
    head = subprocess.run(["head", "-n", "3"], stdin=process.stdout, capture_output=True, check=True)
    process.stdout.close()
    assert process.wait(30) == 0
    assert head.stdout.count(b"\n") == 3
    wait_for(lambda: not [t for t in threading.enumerate() if t.name == "logs"], what="the server's readers to end")


def test_only_people_read_logs(robot):
    from rorg.client import Forbidden

    robot.declare({**services_of(robot), "greeter": {"command": ["sleep", "600"], "may_request": ["waiting"]}})
    robot.wait(lambda: (robot.state.run / "services/greeter/rorg.sock").exists())
    with pytest.raises(Forbidden):
        robot.client("greeter").call("GET", "/v1/services/camera/logs")


def test_a_caller_cannot_have_all_threads(robot, monkeypatch):
    monkeypatch.setattr("rorg.api.logs.MOST_LOGS", 1)
    assert "of 1 are being read" in said(robot, "camera", "arm", code=3)
    assert said(robot, "greeter") == "hello\nthere\n"


# -- Docker ----------------------------------------------------------------------------------------------------


def mounted(folder: Path, name: str, **container: object) -> dict:
    command = ["python3", "-S", "-c", COUNTS, name, f"/counts/{name}"]
    return {
        "command": command,
        "always_on": True,
        "container": {"volumes": [f"{folder}:/counts"], "network_mode": "none", **container},
    }


@pytest.mark.docker
def test_the_log_of_a_program_that_never_stops_printing_has_an_end(tmp_path):
    """Without -f, what was there at the beginning is shown."""
    log = tmp_path / "log"
    long, count, shown = b"x" * 999 + b"\n", 3 * PIECE // 1000, 0
    log.write_bytes(long * count)
    with log.open("ab") as more:
        for line in read_lines(log, None, whole=False):
            shown += bool(line.text)
            more.write(long * 2)
            more.flush()
            assert shown <= count + 3, "a line at the end of a piece comes in two"
    assert shown >= count


@pytest.mark.smoke
def test_docker_gives_times_and_every_line_once(docker_robot, tmp_path):
    robot, folder = docker_robot, tmp_path / "counts"
    robot.with_server = True
    folder.mkdir(mode=0o777)
    services = {name: mounted(folder, name) for name in ("camera", "arm")}
    robot.declare(services)
    robot.wait(lambda: robot.active() == {"camera", "arm"})
    followed = Followed(robot, "camera", "arm")
    wait_for(lambda: followed.numbers("camera") and followed.numbers("arm"))

    def told() -> list[tuple[str, str]]:
        """(time, line), of which the first is older than the one in the middle: Podman knows whole seconds."""
        found = said(robot, "camera", "arm", "-t", "-n", "50").splitlines()
        timed = [(line.split("| ")[1].split(" ")[0], line) for line in found]
        return timed if timed[0][0] < timed[len(timed) // 2][0] else []

    times, lines = zip(*wait_for(told), strict=True)
    assert [*times] == sorted(times)
    assert {line.split()[0] for line in lines} == {"camera", "arm"}
    since = times[len(times) // 2]
    later = said(robot, "camera", "arm", "-t", "--since", since).splitlines()
    assert set(lines[len(times) // 2 + 1 :]) <= set(later)
    assert lines[0] not in later
    robot.client().restart("camera")
    at = followed.numbers("camera")[-1]
    wait_for(lambda: followed.numbers("camera")[-1] > at + 50)
    before = robot.container("camera").id
    robot.declare({**services, "camera": mounted(folder, "camera", environment={"A": "1"})})
    wait_for(lambda: robot.container("camera").id != before and robot.container("camera").state == "running")
    at = followed.numbers("camera")[-1]
    wait_for(lambda: followed.numbers("camera")[-1] > at + 20)
    each_line_once(followed)
    wait_for(lambda: not [t for t in threading.enumerate() if t.name == "logs"], what="the server's readers to end")


class Keeping(Engine):
    """An engine that has noted the start of a run 80 ms after the program began, and keeps these lines."""

    name, local, address = "docker", True, ""
    capabilities = ENGINES["docker"]

    def __init__(self, lines: list[LogLine]) -> None:
        self.lines = lines

    def log_lines(self, container, tail, since, whole):
        yield from self.lines


def test_the_first_lines_of_the_current_run_are_not_of_the_previous_one():
    """The engine notes a start after the first output of the program."""
    with subprocess.Popen(["sleep", "60"]) as program:
        try:
            began = process_start(program.pid)
            times = {"before": began - 0.2, "at once": began + 0.02, "later": began + 0.2}
            lines = [LogLine(nano_stamp(int(t * 1e9)), text.encode(), "") for text, t in times.items()]
            running = Container("c1", "base", "base", "running", started_at=stamp(began + 0.08), pid=program.pid)
            ended = replace(running, state="exited", pid=0)
            for container, expected in ((running, [b"before"]), (ended, [b"before", b"at once"])):
                found = gather(Keeping(lines), lambda _, c=container: c, Asked(["base"], previous=True), lambda: None)
                assert _texts(found) == expected
        finally:
            program.kill()


def _texts(found: Entries) -> list[bytes]:
    texts, over, until = [], False, time.monotonic() + 10
    while not over and time.monotonic() < until:
        entries, over = found.take()
        texts += [entry.text for entry in entries]
        time.sleep(0.001)
    return texts
