"""Whatever is sent to the API: it is answered, or refused with its cause; never an internal error, and others are
served as before."""

from __future__ import annotations

import copy
import json
import logging
import random
import socket
from collections.abc import Iterator
from contextlib import closing
from urllib.parse import quote

import pytest
from api_nonsense import BODIES, FIELDS, MANIFEST, NO_HTTP, ROUTES, SERVICES, answered, connected
from fuzzing import Case, fuzz
from mutations import VALUES, WORDS, mutated_text, mutated_value
from robots import RealRobot

NAMES = ("camera", "lidar", "eyes", "developer", "nav-one", "unknown", "tour", "1", "80", "99999", "Service", "Group")
NUMBERS = ("0", "1", "-1", "0.01", "nan", "inf", "1e400", "9" * 5000, "true", "", " ", "\0", "x")


class Told(logging.Handler):
    """What the server would say of a bug of its own."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        text = self.format(record)
        if "the handler is closed" not in text:  # whoever asked has hung up before the answer
            self.lines.append(text)


@pytest.fixture(scope="module")
def robot(tmp_path_factory) -> Iterator[RealRobot]:
    found = RealRobot(tmp_path_factory.mktemp("robot"), "process", None, with_server=True)
    try:
        found.declare(SERVICES, groups={"eyes": {"services": ["camera", "lidar"]}})
        found.wait(lambda: "camera" in found.active())
        yield found
    finally:
        found.close()


@pytest.fixture
def told(robot) -> Iterator[Told]:
    handler, loggers = Told(), [logging.getLogger(name) for name in ("uvicorn.error", "asyncio")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.addHandler(handler)
        logger.setLevel(logging.ERROR)
    yield handler
    for logger, level in zip(loggers, levels, strict=True):
        logger.removeHandler(handler)
        logger.setLevel(level)


def body_of(chance: random.Random) -> bytes:
    value = mutated_value(copy.deepcopy(chance.choice(BODIES)), chance)
    if isinstance(value, dict) and isinstance(value.get("text"), str) and chance.random() < 0.7:
        value["text"] = mutated_text(MANIFEST, chance)
    text = json.dumps(value, ensure_ascii=chance.random() < 0.5)
    if chance.random() < 0.3:
        text = mutated_text(text, chance)
    return text.encode(errors="surrogatepass")


def word(chance: random.Random, *likely: str) -> str:
    found = chance.choice((*likely, *NAMES)) if chance.random() < 0.8 else str(chance.choice((*WORDS, *VALUES)))
    return found[:3000]


def asking(chance: random.Random) -> tuple[str, bytes]:
    """(method and path, a call of a route with anything in its places)."""
    method, path, route = chance.choice(ROUTES)
    values = {p["name"]: quote(word(chance), safe="", errors="replace") for p in route.get("parameters", ())}
    address, queries = path, []
    for parameter in route.get("parameters", ()):
        if parameter["in"] == "path":
            address = address.replace(f"{{{parameter['name']}}}", values[parameter["name"]] or "x")
        elif parameter["name"] in ("timeout", "tail", "cursor", "force", "mine"):
            queries.append(f"{parameter['name']}={quote(chance.choice(NUMBERS))}")
        elif parameter["name"] != "follow" and chance.random() < 0.7:
            queries.append(f"{parameter['name']}={values[parameter['name']]}")
    if path == "/v1/wait" and not any(q.startswith("timeout=0") for q in queries):
        queries = [*(q for q in queries if "timeout" not in q), "timeout=" + chance.choice(("0", "-1", "nan", "x"))]
    method = method if chance.random() < 0.95 else chance.choice(("PATCH", "POST", "OPTIONS", "GET", "X" * 40))
    body = body_of(chance) if "requestBody" in route or chance.random() < 0.1 else b""
    headers = [f"content-length: {len(body)}", "content-type: application/json"]
    if chance.random() < 0.2:
        headers.append(f"rorg-not-before: {chance.choice(NUMBERS).strip() or 0}".replace("\0", "0"))
    head = "\r\n".join([f"{method} {address}?{'&'.join(queries)} HTTP/1.1", "host: x", "connection: close", *headers])
    return f"{method} {path}", head.encode(errors="replace") + b"\r\n\r\n" + body


@pytest.mark.fuzz
def test_any_body_of_any_route_is_answered(robot, told):
    passes = robot.loop.passes

    def attempt(case: Case) -> None:
        what, case.text = asking(case.chance)
        with closing(connected(robot, case.chance.choice(("", "", "camera")))) as connection:
            connection.sendall(case.text)
            status, body = answered(connection)
        assert status in (200, 204, 307, *range(400, 432), 503, 504), (what, status, body[:500])
        assert status < 400 or body == NO_HTTP or set(json.loads(body)) >= FIELDS, (what, status, body[:500])
        assert not told.lines, told.lines

    fuzz("bodies", 150, attempt)
    assert robot.loop.passes > passes
    assert robot.client().service("camera")["service"] == "camera"


SANE = [
    b"GET /v1/services/camera HTTP/1.1\r\nhost: x\r\n\r\n",
    b"GET /v1/services HTTP/1.1\r\nhost: x\r\nrorg-not-before: 5\r\naccept: */*\r\n\r\n" * 3,
    b'PUT /v1/requests/tour HTTP/1.1\r\nhost: x\r\ncontent-length: 22\r\n\r\n{"services":["lidar"]}',
    b"PUT /v1/requests/tour HTTP/1.1\r\ntransfer-encoding: chunked\r\n\r\n4\r\n{\"a\"\r\n3\r\n:1}\r\n0\r\n\r\n",
    b"GET /v1/events?follow=true HTTP/1.1\r\nhost: x\r\n\r\n",
    b"DELETE /v1/requests/tour HTTP/1.1\r\nexpect: 100-continue\r\nupgrade: h2c\r\nconnection: upgrade\r\n\r\n",
]  # fmt: skip
ODD = (
    b"\r\n", b"\r\n\r\n", b"\n", b"\r", b"\0", b"\xff\xfe", b" ", b":", b": ", b"-1", b"0", b"9" * 400, b"f" * 16,
    b"content-length: 5\r\n", b"content-length: 99999999999999999999\r\n", b"transfer-encoding: chunked\r\n",
    b"%00", b"%", b"?" * 50, b"/../" * 30, b"a: b\r\n" * 200, b"A" * 70000, b"HTTP/9.9", b"HTTP/1.0",
    b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
)  # fmt: skip


def mutated(chance: random.Random) -> bytes:
    text = bytearray(chance.choice(SANE))
    for _ in range(chance.choice((0, 1, 1, 2, 5))):
        at = chance.randrange(len(text) + 1)
        until = min(len(text), at + chance.choice((0, 1, 2, 8, 40)))
        text[at:until] = chance.choice(
            (b"", chance.randbytes(until - at), chance.choice(ODD), bytes(text[at:until]) * 3)
        )
    return bytes(text[: chance.randrange(len(text) + 1)] if chance.random() < 0.3 else text)


@pytest.mark.fuzz
def test_any_bytes_on_the_socket_harm_nobody(robot, told):
    def attempt(case: Case) -> None:
        case.text = mutated(case.chance)
        with closing(connected(robot, case.chance.choice(("", "camera")))) as connection:
            connection.settimeout(0.02)
            try:
                at = case.chance.randrange(len(case.text) + 1)
                connection.sendall(case.text[:at])
                connection.sendall(case.text[at:])
                if case.chance.random() < 0.7:
                    connection.shutdown(socket.SHUT_WR)
                said = connection.recv(1 << 16)
            except OSError:  # it waits for more, or has hung up
                said = b""
        assert b"HTTP/1.1 500" not in said, said[:500]
        assert b"internal" not in said, said[:500]
        assert not told.lines, told.lines
        if case.number % 20 == 0:
            assert robot.client().service("camera")["service"] == "camera"

    fuzz("streams", 150, attempt)
