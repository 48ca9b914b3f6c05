"""Answers, output and logs without end: each attempt of a probe ends by itself, and takes no more than its share."""

from __future__ import annotations

import os
import socket
import subprocess
import threading
import time
import tracemalloc
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import psutil
import pytest
from common import BASE_IMAGE, wait_for
from hosts import HTTP, XML, Host, answer, said
from robots import WORK

from rorg.core.observed import LABEL_OWNER, LABEL_SERVICE
from rorg.core.schedule import Target
from rorg.engines.make import make_engine
from rorg.engines.process.log import PIECE, read_lines, read_log_from
from rorg.errors import EngineError
from rorg.host.git_process import ask_git
from rorg.images.docker import import_stream
from rorg.model.catalog import Image
from rorg.model.probe import Probe
from rorg.probes.answer import YES
from rorg.probes.ask import ask_host
from rorg.probes.ros_state import read_state
from rorg.probes.runner import ProbeRunner
from rorg.store.state_dir import StateDir

MEBI = 1 << 20
LONG = {"process": 64, "docker": 16}
"""MiB of a line. Docker looks through all of them each time that it is asked."""


@contextmanager
def host(say):
    found = Host(say)
    try:
        yield found
    finally:
        found.close()


@contextmanager
def within(seconds: float, memory: int):
    """The block takes no longer, whatever it asks, and not so many bytes more."""
    tracemalloc.start()
    began = time.monotonic()
    try:
        yield
        took, most = time.monotonic() - began, tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert took < seconds
    assert most < memory


@pytest.mark.parametrize("say", HTTP.values(), ids=HTTP)
def test_every_probe_of_a_host_ends(say):
    with host(say) as asked, ThreadPoolExecutor(4) as pool, within(6, 20 * MEBI):
        probes = [Probe(kind, "/x", graph=asked.url) for kind in ("ros_node", "ros_topic", "ros_service")]
        found = list(pool.map(ask_host, [Probe("http", asked.url), *probes]))
    assert not any(answer.ok for answer in found)
    assert max(len(answer.message) for answer in found) < 300


@pytest.mark.parametrize("say", XML.values(), ids=XML)
def test_a_ros_probe_takes_no_more_of_an_answer_than_it_needs(say):
    with host(say) as asked, within(10, 100 * MEBI):
        found = ask_host(Probe("ros_topic", "/x", graph=asked.url))
    assert not found.ok
    assert "does not answer" in found.message
    assert len(found.message) < 400


def test_the_node_that_a_master_names_may_be_anything():
    for say in (HTTP["drip"], XML["values"]):
        with host(say) as node, host(answer([1, "", node.url])) as master, within(6, 100 * MEBI):
            assert not ask_host(Probe("ros_node", "/x", graph=master.url)).ok
            assert node.asked == 1
    for place in (
        "https://localhost:1",
        "file:///etc/shadow",
        "http://",
        "http://[",
        "http://x:99999",
        "",
        5,
        None,
        [[]],
    ):
        with host(answer([1, "", place])) as master:
            for kind in ("ros_node", "ros_service"):
                assert "does not answer" in ask_host(Probe(kind, "/x", graph=master.url)).message


@pytest.mark.parametrize(
    "value", [5, "", [], [1], [[], [], []], [1, "", 7], [1, "", [5, 6, 7]], [1, "", [[["a"]]] * 3], None]
)
def test_what_is_no_graph_ends_neither_probe_nor_watch(value):
    with host(answer(value)) as master:
        assert not ask_host(Probe("ros_topic", "/x", graph=master.url)).ok
        with pytest.raises(OSError, match="its answer"):
            read_state(master.url)


def test_a_redirect_is_an_answer_and_leads_nowhere():
    with host(said(b"HTTP/1.1 200 OK\r\n\r\n")) as other:
        moved = f"HTTP/1.1 302 Found\r\nLocation: {other.url}\r\nContent-Length: 0\r\n\r\n"
        with host(said(moved.encode())) as asked:
            assert ask_host(Probe("http", asked.url)) == YES
            assert not ask_host(Probe("ros_node", "/x", graph=asked.url)).ok
        assert other.asked == 0


@pytest.mark.slow
def test_a_name_that_nobody_looks_up_in_time(monkeypatch):
    """As with a name server that is out of reach: the resolver tries for half a minute."""
    back, asked, real = threading.Event(), [], socket.getaddrinfo

    def slow(host, *args, **more):
        if host == "robot.example" and not more.get("flags"):
            asked.append(host)
            back.wait(60)
        return real("127.0.0.1" if host == "robot.example" and not more.get("flags") else host, *args, **more)

    monkeypatch.setattr(socket, "getaddrinfo", slow)
    with host(said(b"HTTP/1.1 200 OK\r\n\r\n")) as there:
        probe = Probe("tcp", f"robot.example:{there.port}")
        with within(6, 4 * MEBI):
            assert "robot.example timed out" in ask_host(probe).message
            assert "robot.example timed out" in ask_host(probe).message
        assert len(asked) == 1, "whoever asks meanwhile waits for the same look-up"
        back.set()
        wait_for(lambda: ask_host(probe) == YES)


@pytest.fixture(params=["process", pytest.param("docker", marks=pytest.mark.docker)])
def running(request, tmp_path, monkeypatch):
    """Begins containers of one engine, and ends them."""
    if request.param == "docker":
        monkeypatch.setenv("DOCKER_HOST", request.getfixturevalue("dockerd").host)
    engine, made = make_engine(request.param, StateDir(tmp_path / "state").prepare()), []

    def begin(*command: str, **spec):
        labels = {LABEL_OWNER: engine.owner, LABEL_SERVICE: "x", "rorg.io/spec": "", "rorg.io/declared": ""}
        name = f"x-{os.urandom(4).hex()}"
        options = {"image": BASE_IMAGE, "command": list(command), "network_mode": "host", "init": True, **spec}
        made.append(engine.create(name, options, labels))
        engine.start(made[-1])
        return made[-1]

    yield engine, begin
    for container in made:
        engine.stop(container, "SIGKILL", 10.0)
        engine.remove(container)


def test_a_command_that_prints_without_end_is_ended(running):
    engine, begin = running
    container = begin(*WORK)
    with within(8, 8 * MEBI):
        code, output = engine.exec(
            container, ["python3", "-S", "-c", "import os\nwhile True: os.write(1, bytes(1 << 16))"], 60.0
        )
    assert code == 137
    assert 0 < len(output) < 300 << 10
    assert output.endswith(b"it prints more than 256 KiB")


def test_a_line_without_end_is_searched_and_hides_nothing(running):
    """It comes in pieces, and what follows it is found."""
    engine, begin = running
    write = f"import os, signal\nfor _ in range({LONG[engine.name]}): os.write(1, b'x' * {MEBI})\nprint(flush=True)\n"
    container = begin("python3", "-S", "-c", write + "print('serving', flush=True)\nsignal.pause()")
    run = engine.inspect(container)
    ask, probe = ProbeRunner(engine, lambda service: run), Probe("log", "^serving$")
    with within(120, 8 * MEBI):
        wait_for(lambda: ask(("x", "ready"), Target(probe, run.incarnation, 1.0)) == YES, 100)
        assert sum(len(line.text) for line in engine.log_lines(container, 2, None, False)) > 0
        assert [line.text for line in engine.log_lines(container, 1, None, False)][-2].endswith(b"serving\n")


def test_a_long_line_in_a_file(tmp_path):
    log = tmp_path / "log"
    with log.open("wb") as file:
        file.write(b"first\n")
        for _ in range(40):
            file.write(b"x" * MEBI)
        file.write(b"\nlast\nhalf")
    with within(30, 8 * MEBI):
        pieces = deque(read_log_from(log, 0), 3)
        assert max(len(text) for text, _ in pieces) <= PIECE
        assert pieces[-1][0].endswith(b"\nlast\nhalf")
        assert list(read_log_from(log, pieces[-1][1])) == [(b"half", pieces[-1][1])]
        assert b"".join(line.text for line in read_lines(log, 2, False)) == b"last\nhalf"
        assert sum(len(line.text) for line in read_lines(log, 3, False)) > 40 * MEBI


def test_a_line_that_was_found_is_not_looked_for_again(running):
    """A probe that goes on (`failures`) reads on, or not at all: never what it has read."""
    engine, begin = running
    container = begin("sh", "-c", "echo serving; exec python3 -S -c 'import signal; signal.pause()'")
    run, read = engine.inspect(container), []

    class Counted:
        capabilities, local = engine.capabilities, engine.local

        def log_since(self, container, place):
            for text, after in engine.log_since(container, place):
                read.append(len(text))
                yield text, after

    ask, target = ProbeRunner(Counted(), lambda service: run), Target(Probe("log", "serving"), run.incarnation, 1.0)
    wait_for(lambda: ask(("x", "ready"), target) == YES)
    before = len(read)
    assert all(ask(("x", "ready"), target) == YES for _ in range(5))
    assert len(read) == before
    other = Target(Probe("log", "silent"), run.incarnation, 1.0)
    assert not ask(("x", "ready"), other).ok, "another pattern is another question, from the beginning on"
    assert len(read) > before
    assert ask(("x", "live"), target) == YES


def test_an_import_that_says_much_is_not_held_up(tmp_path, monkeypatch):
    monkeypatch.setattr("rorg.images.cancel.PATIENCE", 0.5)

    def image(script: str) -> Image:
        return Image("x", None, "Dockerfile", {}, ("sh", "-c", script), str(tmp_path))

    talk = "head -c 300000 /dev/zero | tr '\\0' e >&2"
    with import_stream(image(f"{talk}; echo tar")) as stream:
        assert stream.read() == b"tar\n"
    with (
        pytest.raises(EngineError, match=r"^[^:]*: e{490,500}; fix spec.import"),
        import_stream(image(f"{talk}; exit 3")) as stream,
    ):
        assert stream.read() == b""
    with pytest.raises(EngineError, match="exit code"), import_stream(image("exec sleep 600")):
        pass


def test_a_git_that_hangs_is_ended_with_what_it_runs(tmp_path):
    """As on a disk that does not answer: here a filter of the repository's own configuration."""
    call = ["git", "-c", "user.name=x", "-c", "user.email=x@x", "-C", str(tmp_path)]
    subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)
    (tmp_path / ".gitattributes").write_text("*.yaml filter=slow\n")
    (tmp_path / "a.yaml").write_text("x")
    subprocess.run([*call, "add", "."], check=True)
    subprocess.run([*call, "commit", "-q", "-m", "x"], check=True)
    subprocess.run([*call, "config", "filter.slow.clean", "sleep 98765"], check=True)
    (tmp_path / "a.yaml").write_text("y")
    with within(10, 4 * MEBI):
        assert not ask_git(tmp_path, "status", "--porcelain", patience=0.5).yes
    assert ask_git(tmp_path, "rev-parse", "HEAD").yes
    wait_for(lambda: not [p for p in psutil.process_iter(["cmdline"]) if "98765" in (p.info["cmdline"] or [])])
