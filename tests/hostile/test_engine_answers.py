"""An engine whose answers never come to an end costs no memory, and is named."""

from __future__ import annotations

import contextlib
import socketserver
import threading
import tracemalloc
from collections.abc import Iterator

import pytest
from common import BASE_IMAGE
from robots import WORK

from rorg.core.observed import LABEL_OWNER, LABEL_SERVICE
from rorg.engines.docker.engine import DockerEngine
from rorg.engines.log_lines import Reading
from rorg.errors import EngineError, RorgError, Unreachable

MOST_MEMORY = 200 << 20
PING = b"HTTP/1.1 200 OK\r\nApi-Version: 1.43\r\nContent-Length: 2\r\n\r\nOK"
OK = b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\n\r\n"
ERROR = OK.replace(b"200 OK", b"500 No")
CHUNKED = OK.replace(b"\r\n\r\n", b"\r\nTransfer-Encoding: chunked\r\n\r\n")
PIECE = b'{"Id":"x"},' * 6000


class Endless(socketserver.ThreadingUnixStreamServer):
    """Answers a ping, and whatever else it is asked for as long as anybody listens."""

    daemon_threads = True
    head, piece = OK, PIECE


class Handler(socketserver.StreamRequestHandler):
    def handle(self) -> None:
        server = self.server
        assert isinstance(server, Endless)
        with contextlib.suppress(OSError):
            while (line := self.rfile.readline()) and line.strip():
                while self.rfile.readline().strip():
                    pass
                if b"/_ping" in line:
                    self.wfile.write(PING)
                    continue
                self.wfile.write(server.head)
                while True:
                    self.wfile.write(server.piece)


@pytest.fixture
def endless(tmp_path) -> Iterator[Endless]:
    with Endless(str(tmp_path / "engine.sock"), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server
        server.shutdown()


def next_event(engine: DockerEngine) -> None:
    events = engine.events(Reading())
    next(events)
    next(events)


CALLS = {
    "list": lambda engine: engine.list(),
    "inspect": lambda engine: engine.inspect("abc"),
    "events": next_event,
    "disk": lambda engine: engine.images(),
    "images": lambda engine: engine.missing_images(["x"]),
    "start": lambda engine: engine.start("abc"),
}
HEADS = {
    "plain": (OK, PIECE),
    "chunks": (CHUNKED, b"%x\r\n%s\r\n" % (len(PIECE), PIECE)),
    "error": (ERROR, PIECE),
}


@pytest.mark.parametrize("head", HEADS)
@pytest.mark.parametrize("call", CALLS)
def test_an_answer_without_end_is_an_error_that_names_the_engine(endless, call, head):
    endless.head, endless.piece = HEADS[head]
    engine = DockerEngine("mine", f"unix://{endless.server_address}")
    tracemalloc.start()
    try:
        with pytest.raises(EngineError if head == "error" else Unreachable) as failed:
            CALLS[call](engine)
        assert tracemalloc.get_traced_memory()[1] < MOST_MEMORY
    finally:
        tracemalloc.stop()
    if head != "error":
        assert f"the engine at unix://{endless.server_address} sent" in str(failed.value)
    assert len(str(failed.value)) < 20_000


@pytest.mark.slow
def test_lines_without_end_after_a_list_end(endless):
    endless.piece = b'{"Action": "start", "Actor": {"ID": "x"}}\n' * 1000
    engine = DockerEngine("mine", f"unix://{endless.server_address}")
    with pytest.raises(Unreachable, match="of more than"):
        engine.list({"x": None})  # type: ignore[dict-item]


def test_json_that_is_nested_without_end_is_an_error(endless):
    endless.head = OK.replace(b"\r\n\r\n", b"\r\nContent-Length: 1000000\r\n\r\n")
    endless.piece = b"[" * 1000000
    with pytest.raises(RorgError, match="nested too deep"):
        DockerEngine("mine", f"unix://{endless.server_address}").list()


@pytest.mark.docker
def test_large_answers_of_a_real_engine_are_read_and_its_refusals_keep_the_connection(dockerd):
    engine = DockerEngine("large", dockerd.host)
    environment = {f"X{n}": "x" * 1000 for n in range(1000)}
    spec = {"image": BASE_IMAGE, "command": WORK, "environment": environment}
    made = engine.create("large", spec, {LABEL_OWNER: "large", LABEL_SERVICE: "large"})
    try:
        for _ in range(2):
            assert engine.inspect("0" * 64) is None
            assert [c.id for c in engine.list()] == [made]
    finally:
        engine.remove(made)
