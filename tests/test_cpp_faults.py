"""The C++ client under the address, undefined and thread sanitizers: what outlives what, forks, restarts of rorg, what
is lost, nonsense for answers, and TLS."""

from __future__ import annotations

import os
import random
import socket
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

import pytest
from conftest import ROOT, free_port
from robots import RealRobot, write_tree
from test_deployment import certificate

from rorg.client import Client

CLIENT = ROOT / "clients/cpp"
TREE = {"camera": {"idle": {"action": "pause"}}, "lidar": {}, "arm": {"driver": {}, "conflicts": ["lidar"]}}
SANITIZERS = {"address": ["-fsanitize=address,undefined", "-fno-sanitize-recover=all",
                          # What the address sanitizer sees as well, and half of the compiler's time.
                          "-fno-sanitize=null,alignment,object-size,vptr"], "thread": ["-fsanitize=thread"]}
HOW = {"ASAN_OPTIONS": "detect_stack_use_after_return=1", "UBSAN_OPTIONS": "print_stacktrace=1",
       "TSAN_OPTIONS": "halt_on_error=1:die_after_fork=0"}
BOTH = pytest.mark.parametrize("kind", SANITIZERS)


@pytest.fixture(scope="session")
def sanitized(tmp_path_factory) -> dict[str, Path]:
    """The tests' program, once for each sanitizer, with TLS."""
    folder = tmp_path_factory.mktemp("sanitized")
    builds = [subprocess.Popen(["g++", "-std=c++17", "-O1", "-g1", "-pthread", "-DRORG_WITH_TLS", *flags, "-I",
                                CLIENT / "include", CLIENT / "tests/calls.cpp", "-o", folder / name, "-lssl", "-lcrypto"])
              for name, flags in SANITIZERS.items()]
    assert [build.wait() for build in builds] == [0, 0]
    return {name: folder / name for name in SANITIZERS}


@pytest.fixture
def robot(tmp_path):
    found = RealRobot(tmp_path, "process", None, with_door=True)
    found.declare(TREE)
    found.wait(lambda: len(found.containers()) == 3)
    yield found
    found.close()


@contextmanager
def program(path: Path, *words: str, **env: str):
    """The program, which must end well when the block has."""
    running = subprocess.Popen([path, *words], text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                               stderr=subprocess.PIPE, env={**os.environ, **HOW, **env})
    try:
        yield running
        _, errors = running.communicate(timeout=120)
        assert running.returncode == 0 and not errors, errors  # one that is ending may be past its exit code
    finally:
        running.kill()


def heard(running: subprocess.Popen, word: str) -> None:
    line = running.stdout.readline().strip()
    assert line == word, line or running.communicate(timeout=60)[1]


@BOTH
@pytest.mark.parametrize("word", ["calls", "lifetimes", "forks", "left"])
def test_no_memory_is_misused(sanitized, robot, kind, word):
    with program(sanitized[kind], word, RORG_SOCKET=robot.socket()):
        pass


@BOTH
def test_it_is_told_what_it_lost(sanitized, robot, kind):
    with program(sanitized[kind], "losses", RORG_SOCKET=robot.socket()) as running:
        heard(running, "kill")
        robot.kill("camera")
        print("killed", file=running.stdin, flush=True)
        heard(running, "hold")
        robot.client().hold("camera", 60)
        print("held", file=running.stdin, flush=True)


# -- rorg goes away ----------------------------------------------------------------------------------------------


@contextmanager
def daemon(folder: Path, *words: str):
    """`rorg run` in a process of its own, as a function that begins it (again); ended with its services."""
    state, begun = folder / "state", []

    def begin() -> subprocess.Popen:
        with (folder / "log").open("a") as log:
            begun.append(subprocess.Popen([sys.executable, "-m", "rorg", "run", str(folder / "tree"), "--state-dir", str(state),
                                           "--engine", "process", *words], stderr=log))
        return begun[-1]

    try:
        yield begin
    finally:
        from rorg.daemon.wiring import make_engine
        from rorg.store.state_dir import StateDir

        begun[-1].terminate()
        begun[-1].wait(30)
        engine = make_engine("process", StateDir(state))
        for container in engine.list():
            engine.stop(container.id, "SIGKILL", 5.0)
            engine.remove(container.id)


@BOTH
def test_a_restart_of_rorg_is_no_more_than_a_longer_wait(sanitized, tmp_path, kind):
    write_tree(tmp_path / "tree", TREE)
    with daemon(tmp_path) as begin:
        rorg = begin()
        with program(sanitized[kind], "outages", "1", RORG_SOCKET=str(tmp_path / "state/run/rorg.sock")) as running:
            heard(running, "go")
            rorg.kill()
            rorg.wait(30)
            begin()
            Client(str(tmp_path / "state/run/rorg.sock")).services()
            print("again", file=running.stdin, flush=True)


@BOTH
def test_over_tls(sanitized, tmp_path, kind):
    for name, authority in (("authority", ""), ("robot", "authority"), ("ada", "authority")):
        certificate(tmp_path, name, authority)
    write_tree(tmp_path / "tree", {"camera": {}})
    port = free_port()
    files = {"--tls-cert": "robot.pem", "--tls-key": "robot.key", "--tls-ca": "authority.pem"}
    with daemon(tmp_path, "--listen", f"127.0.0.1:{port}", *(w for k, v in files.items() for w in (k, str(tmp_path / v)))) as begin:
        begin()
        with program(sanitized[kind], "secured", RORG_ADDRESS=f"https://127.0.0.1:{port}", RORG_CA=str(tmp_path / "authority.pem"),
                     RORG_CERT=str(tmp_path / "ada.pem"), RORG_KEY=str(tmp_path / "ada.key")):
            pass


# -- what is answered --------------------------------------------------------------------------------------------


@contextmanager
def server(folder: Path, answer):
    """A socket on which `answer(connection)` is called for each connection, in a thread; None instead of one closes."""
    path = folder / "fake.sock"
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(path))
    listener.listen(64)

    def serve() -> None:
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            threading.Thread(target=one, args=(connection,), daemon=True).start()

    def one(connection: socket.socket) -> None:
        with connection:
            try:
                answer(connection)
            except OSError:
                pass  # it hung up

    threading.Thread(target=serve, daemon=True).start()
    try:
        yield str(path)
    finally:
        listener.shutdown(socket.SHUT_RDWR)
        listener.close()


def asked(connection: socket.socket) -> tuple[str, str, dict[str, str], str] | None:
    """Method, path, headers and body of the next call; None when there is none."""
    text = b""
    while b"\r\n\r\n" not in text:
        more = connection.recv(65536)
        if not more:
            return None
        text += more
    head, _, body = text.partition(b"\r\n\r\n")
    first, *lines = head.decode().split("\r\n")
    headers = dict(line.lower().split(": ", 1) for line in lines)
    while len(body) < int(headers.get("content-length", 0)):
        body += connection.recv(65536)
    method, path, _ = first.split(" ")
    return method, path, headers, body.decode()


def said(status: int, body: str, **headers: object) -> bytes:
    more = "".join(f"{name.replace('_', '-')}: {value}\r\n" for name, value in headers.items())
    return f"HTTP/1.1 {status} x\r\n{more}content-length: {len(body)}\r\n\r\n{body}".encode()


EVENTS = b'{"seq": 7, "kind": "crashed", "service": "camera", "message": "m"}\n{"seq": 8, "kind": "pressure", "shed": {"camera": "r"}}\n'
SANE = [
    said(200, '{"service": "camera", "conditions": [{"type": "Ready", "status": "True"}], "rank": 5e1}', rorg_generation=5),
    said(200, '{"ready": true, "services": {"camera": {"ready": true, "incarnation": "x", "reason": ""}}}'),
    said(504, '{"title": "t", "code": "not-ready", "cause": "c\\u00e9", "services": {"camera": {"ready": false}}}'),
    said(200, '[{"id": "x", "services": ["camera"]}]', etag='"0123"'), said(409, '{"title": "t", "code": "refused"}'),
    said(503, "busy", Retry_After=1), said(204, ""), b"HTTP/1.1 200 OK\r\n\r\n{}",
    b"HTTP/1.1 200 OK\r\ntransfer-encoding: chunked\r\n\r\n4\r\n[1,2\r\n1\r\n]\r\n0\r\n\r\n",
    b"HTTP/1.1 200 OK\r\nrorg-cursor: 3\r\ntransfer-encoding: chunked\r\n\r\n%x\r\n%s\r\n0\r\n\r\n" % (len(EVENTS), EVENTS),
]
ODD = [b"\r\n", b"\r\n\r\n", b"-1", b"0", b"ffffffffffffffff", b"99999999999999999999", b'"', b"\\u", b"\\ud800", b"[" * 300, b"{",
       b"\x00", b"\xff\xfe", b"1e999", b"nan", b"HTTP/1.1 100 x\r\n\r\n", b": ", b"A" * 70000]


def mutated(dice: random.Random) -> bytes:
    text = bytearray(dice.choice(SANE))
    for _ in range(dice.choice([0, 1, 1, 2, 5])):
        at = dice.randrange(len(text) + 1)
        until = min(len(text), at + dice.choice([1, 1, 2, 8, 40]))
        text[at:until] = dice.choice([b"", dice.randbytes(until - at), dice.choice(ODD), bytes(text[at:until]) * 3])
    return bytes(text[:dice.randrange(len(text) + 1)] if dice.random() < 0.1 else text)


def test_nonsense_for_answers_neither_crashes_nor_holds_it_up(sanitized, tmp_path):
    dice, lock, count = random.Random(9), threading.Lock(), [0]

    def answer(connection: socket.socket) -> None:
        while asked(connection):
            with lock:
                count[0] += 1
                text, stays = mutated(dice), dice.random() < 0.5
            connection.sendall(text)
            if not stays:
                return
            if dice.random() < 0.98:
                connection.shutdown(socket.SHUT_WR)  # else it may wait for more, which does not come

    with server(tmp_path, answer) as path, program(sanitized["address"], "nonsense", "1800", RORG_SOCKET=path):
        pass
    assert count[0] >= 2000


class Script:
    """What rorg answers to scripted() of the program, and what it was asked."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, str, str]] = []
        self.waits = 0

    def __call__(self, connection: socket.socket) -> None:
        while call := asked(connection):
            method, path, headers, body = call
            if path.startswith(("/v1/events", "/v1/groups")):
                connection.sendall(said(403, '{"title": "cannot see events", "code": "forbidden"}'))
                continue
            self.calls.append((method, path.partition("&timeout")[0], headers.get("rorg-not-before", "")))
            found = self.answer(method, path, body)
            if found is None:
                return
            connection.sendall(found)

    def answer(self, method: str, path: str, body: str) -> bytes | None:
        times = sum(call[:2] == (method, path.partition("&timeout")[0]) for call in self.calls)
        ending = said(503, '{"title": "cannot wait", "code": "ending"}', Retry_After=1)
        if path == "/v1/requests/r":
            return said(200, "{}", rorg_generation=7)
        if path == "/v1/requests/other":
            return said(204, "", rorg_generation=12)
        if path == "/v1/manifests/Service/cut":
            return None if method == "PUT" else said(200, "text of cut", etag='"d2"')
        if path.startswith("/v1/manifests/Service/gone"):
            return None if method == "DELETE" else said(404, '{"title": "t", "code": "not-found"}')
        if path.startswith("/v1/manifests"):
            return said(200, '{"digest": "d1", "generation": 9}', rorg_generation=9)
        if "restart" in path:
            return None if "cut" in path else ending if "ending" in path and times == 1 else said(200, "{}", rorg_generation=20)
        if "services=late" in path:
            late = path.endswith("timeout=0.000000")
            return said(504, '{"title": "cannot wait", "code": "not-ready", "cause": "too late"}') if late else None
        if "services=b" in path:
            return self.both()
        return said(200, '{"ready": true}')

    def both(self) -> bytes | None:
        self.waits += 1
        one = '"a": {"ready": true, "incarnation": "run1", "reason": ""}'
        if self.waits == 1:
            return said(503, '{"title": "cannot wait", "code": "ending"}', Retry_After=1)
        if self.waits == 2:
            return None
        if self.waits == 3:
            return said(200, '{"ready": true, "services": {%s}}' % one)
        return said(504, '{"title": "cannot wait", "code": "not-ready", "cause": "b: it starts", "services": '
                         '{%s, "b": {"ready": false, "incarnation": "", "reason": "it starts"}}}' % one)


def test_what_it_changed_it_asks_to_see_and_repeats_only_what_it_may(sanitized, tmp_path):
    script = Script()
    with server(tmp_path, script) as path, program(sanitized["address"], "scripted", RORG_SOCKET=path):
        pass
    both = ("GET", "/v1/wait?services=a&services=b", "12")
    late = [call for call in script.calls if "late" in call[1]]
    assert len(late) >= 2 and {call[2] for call in late} == {"20"}
    manifests = [("PUT", "/v1/manifests/Service/cut", "9"), ("GET", "/v1/manifests/Service/cut", "20"),
                 ("DELETE", "/v1/manifests/Service/gone?base=d1&message=", "0")]
    assert [(m, p, n or "0") for m, p, n in script.calls if "late" not in p] == [
        ("GET", "/v1/services/a", "0"), ("PUT", "/v1/requests/r", "0"), ("GET", "/v1/services/b", "7"),
        ("PUT", "/v1/manifests/Service/c", "0"), ("GET", "/v1/wait?services=c", "9"), ("DELETE", "/v1/requests/other", "0"),
        both, both, both, both, ("POST", "/v1/services/cut/restart", "9"), ("POST", "/v1/services/ending/restart", "9"),
        ("POST", "/v1/services/ending/restart", "9"), ("POST", "/v1/services/a/restart", "9"), ("GET", "/v1/wait?services=a", "20"),
        *manifests, ("GET", "/v1/manifests/Service/gone", "20"), ("DELETE", "/v1/requests/r", "0")]
