"""The C++ client against a server of the test: nonsense for answers, and what it sends and repeats."""

from __future__ import annotations

import contextlib
import itertools
import json
import random
import socket
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from cpp_program import program
from fuzzing import Case, Figures, count, report
from http_message import read_message

ROUNDS, OF_ONE = "1800", 2000
"""Rounds of one program, and how many answers it takes at the least."""


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
        with connection, contextlib.suppress(OSError):  # it hung up
            answer(connection)

    threading.Thread(target=serve, daemon=True).start()
    try:
        yield str(path)
    finally:
        listener.shutdown(socket.SHUT_RDWR)
        listener.close()


def asked(connection: socket.socket) -> tuple[str, str, dict[str, str], str] | None:
    """Method, path, headers and body of the next call; None when there is none."""
    found = read_message(connection)
    if found is None:
        return None
    head, body = found
    first, *lines = head.decode().split("\r\n")
    headers = dict(line.lower().split(": ", 1) for line in lines)
    method, path, _ = first.split(" ")
    return method, path, headers, body.decode()


def said(status: int, body: str, **headers: object) -> bytes:
    more = "".join(f"{name.replace('_', '-')}: {value}\r\n" for name, value in headers.items())
    return f"HTTP/1.1 {status} x\r\n{more}content-length: {len(body)}\r\n\r\n{body}".encode()


EVENTS = (
    b'{"seq": 7, "kind": "lost", "service": "camera", "cause": "crashed", "message": "m", "requests": ["x"]}\n'
    b'{"seq": 8, "kind": "request-dropped", "request": "x"}\n'
)
SANE = [
    said(
        200,
        '{"service": "camera", "conditions": [{"type": "Ready", "status": "True"}], "effective_priority": 5e1}',
        rorg_generation=5,
    ),
    said(200, '{"ready": true, "services": {"camera": {"ready": true, "incarnation": "x", "reason": ""}}}'),
    said(504, '{"title": "t", "code": "not-ready", "cause": "c\\u00e9", "services": {"camera": {"ready": false}}}'),
    said(200, '[{"id": "x", "services": ["camera"]}]', etag='"0123"'),
    said(409, '{"title": "t", "code": "refused"}'),
    said(503, "busy", Retry_After=1),
    said(204, ""),
    b"HTTP/1.1 200 OK\r\n\r\n{}",
    b"HTTP/1.1 200 OK\r\ntransfer-encoding: chunked\r\n\r\n4\r\n[1,2\r\n1\r\n]\r\n0\r\n\r\n",
    b"HTTP/1.1 200 OK\r\nrorg-cursor: 3\r\ntransfer-encoding: chunked\r\n\r\n"
    b"%x\r\n%s\r\n0\r\n\r\n" % (len(EVENTS), EVENTS),
]
ODD = [
    b"\r\n",
    b"\r\n\r\n",
    b"-1",
    b"0",
    b"ffffffffffffffff",
    b"99999999999999999999",
    b'"',
    b"\\u",
    b"\\ud800",
    b"[" * 300,
    b"{",
    b"\x00",
    b"\xff\xfe",
    b"1e999",
    b"nan",
    b"HTTP/1.1 100 x\r\n\r\n",
    b": ",
    b"A" * 70000,
]


def mutated(dice: random.Random) -> bytes:
    text = bytearray(dice.choice(SANE))
    for _ in range(dice.choice([0, 1, 1, 2, 5])):
        at = dice.randrange(len(text) + 1)
        until = min(len(text), at + dice.choice([1, 1, 2, 8, 40]))
        text[at:until] = dice.choice([b"", dice.randbytes(until - at), dice.choice(ODD), bytes(text[at:until]) * 3])
    return bytes(text[: dice.randrange(len(text) + 1)] if dice.random() < 0.1 else text)


class Nonsense:
    """Answers, each of them by its number."""

    def __init__(self, first: int) -> None:
        self.numbers, self.lock = itertools.count(first), threading.Lock()
        self.last: dict[int, bytes] = {}
        """By number; the last ones are kept where the client finds no end."""

    def __call__(self, connection: socket.socket) -> None:
        while asked(connection):
            with self.lock:
                number = next(self.numbers)
                dice = Case.of("answers", number).chance
                text, stays = mutated(dice), dice.random() < 0.5
                self.last = {**dict(list(self.last.items())[-20:]), number: text}
            while number % 300 == 299:  # it drips, until nobody listens any more
                connection.sendall(b"H")
                time.sleep(0.02)
            connection.sendall(text)
            if not stays:
                return
            if dice.random() < 0.98:
                connection.shutdown(socket.SHUT_WR)  # else it may wait for more, which does not come


@pytest.mark.slow
@pytest.mark.fuzz
def test_nonsense_for_answers_neither_crashes_nor_holds_it_up(sanitized, tmp_path):
    """As many as are asked for, some thousand to one program."""
    figures, began, first, most = Figures(), time.monotonic(), 0, count("answers", OF_ONE)
    while first < most:
        nonsense, folder = Nonsense(first), tmp_path / str(first)
        folder.mkdir()
        try:
            with server(folder, nonsense) as path, program(sanitized["address"], "nonsense", ROUNDS, RORG_SOCKET=path):
                pass
        except Exception as bug:
            case = Case.of("answers", max(nonsense.last, default=first))
            case.text = repr(nonsense.last)
            figures.findings.append(case.keep(f"one of the last answers: {type(bug).__name__}: {str(bug)[:500]}"))
            break
        answered = next(nonsense.numbers) - first
        assert answered >= OF_ONE
        figures.cases, first = figures.cases + answered, first + answered
    report("answers", figures, time.monotonic() - began)


class Script:
    """What rorg answers to scripted() of the program, and what it was asked."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, str, str]] = []
        self.waits = 0
        self.asked_at: list[float] = []

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
            done = said(200, "{}", rorg_generation=20)
            if "much" in path:
                self.asked_at.append(time.monotonic())
                much = said(429, '{"title": "cannot", "code": "too-many-requests"}', Retry_After=1)
                return much if times == 1 else done
            return None if "cut" in path else ending if "ending" in path and times == 1 else done
        if "services=late" in path:
            late = path.endswith("timeout=0.000000")
            return said(504, '{"title": "cannot wait", "code": "not-ready", "cause": "too late"}') if late else None
        if "services=twice" in path:
            time.sleep(1.2 if times == 3 else 0)  # as one who waits there
            return None if times in (1, 3, 4) else said(503, "", Retry_After=1) if times == 2 else said(200, "{}")
        if "services=b" in path:
            return self.both()
        return said(200, '{"ready": true}')

    def both(self) -> bytes | None:
        self.waits += 1
        a = {"ready": True, "incarnation": "run1", "reason": ""}
        b = {"ready": False, "incarnation": "", "reason": "it starts"}
        late = {"title": "cannot wait", "code": "not-ready", "cause": "b: it starts", "services": {"a": a, "b": b}}
        answers = [
            said(503, '{"title": "cannot wait", "code": "ending"}', Retry_After=1),
            None,
            said(200, json.dumps({"ready": True, "services": {"a": a}})),
            said(504, json.dumps(late)),
        ]
        return answers[self.waits - 1]


@pytest.mark.slow
def test_what_it_changed_it_asks_to_see_and_repeats_only_what_it_may(sanitized, tmp_path):
    script = Script()
    with server(tmp_path, script) as path, program(sanitized["address"], "scripted", RORG_SOCKET=path):
        pass
    both = ("GET", "/v1/wait?services=a&services=b", "12")
    late = [call for call in script.calls if "late" in call[1]]
    first, second = script.asked_at
    assert second - first >= 1.0, "who asked too much waits as long as it is told"
    assert len(late) >= 2
    assert {call[2] for call in late} == {"20"}
    manifests = [
        ("PUT", "/v1/manifests/Service/cut", "0"),
        ("GET", "/v1/manifests/Service/cut", "20"),
        ("DELETE", "/v1/manifests/Service/gone?base=d1&message=", "0"),
    ]
    assert [(m, p, n or "0") for m, p, n in script.calls if "late" not in p and "twice" not in p] == [
        ("GET", "/v1/services/a", "0"),
        ("PUT", "/v1/requests/r", "0"),
        ("GET", "/v1/services/b", "7"),
        ("PUT", "/v1/manifests/Service/c", "0"),
        ("GET", "/v1/wait?services=c", "9"),
        ("DELETE", "/v1/requests/other", "0"),
        both,
        both,
        both,
        both,
        ("POST", "/v1/services/cut/restart", "9"),
        ("POST", "/v1/services/ending/restart", "9"),
        ("POST", "/v1/services/ending/restart", "9"),
        ("POST", "/v1/services/much/restart", "9"),
        ("POST", "/v1/services/much/restart", "9"),
        ("POST", "/v1/services/a/restart", "9"),
        ("GET", "/v1/wait?services=a", "20"),
        *manifests,
        ("GET", "/v1/manifests/Service/gone", "20"),
        ("DELETE", "/v1/requests/r", "0"),
    ]
