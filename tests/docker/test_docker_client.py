"""The connection to the Docker engine: what it says of the containers that are there, and when it is lost."""

from __future__ import annotations

import contextlib
import os
import socket
import ssl
import subprocess
import sys
import threading
import time

import pytest
from common import BASE_IMAGE, wait_for
from forwarder import Forwarder
from robots import WORK
from tools import tool

from rorg.core.observed import LABEL_OWNER, LABEL_SERVICE
from rorg.core.operations import Start
from rorg.core.plan import Action
from rorg.engines.docker.answers import Frames
from rorg.engines.docker.client import Client
from rorg.engines.docker.engine import DockerEngine
from rorg.engines.docker.errors import Refused, refusal
from rorg.engines.docker.release import Release, version_text
from rorg.engines.execute import failure
from rorg.engines.log_lines import Reading
from rorg.errors import EngineError, TimedOut, Unreachable

COUNT = 4


@pytest.fixture
def engine(dockerd):
    found = DockerEngine("listing", dockerd.host)
    spec = {"image": BASE_IMAGE, "command": WORK, "network_mode": "host", "stop_signal": "SIGKILL"}
    for n in range(COUNT):
        name = f"listing-{n}"
        found.start(found.create(name, spec, {LABEL_OWNER: "listing", LABEL_SERVICE: name}))
    yield found
    for container in found.list():
        found.stop(container.id, "SIGKILL", 5.0)
        found.remove(container.id)


@pytest.mark.docker_only("it tells no past events, so that all are looked at again")
def test_what_is_known_is_not_looked_at_again_unless_anything_happened(engine, dockerd, monkeypatch):
    monkeypatch.setattr("rorg.engines.docker.engine.LAG", 0.0)  # what made them is long ago
    known = {c.id: c for c in engine.list()}
    assert len(known) == COUNT
    again = engine.list(known)
    assert [known[c.id] is c for c in again] == [True] * COUNT


CHANGES = {
    "update": lambda api, c: api.update_container(c, cpu_shares=512),
    "restart": lambda api, c: api.restart(c, timeout=0),
    "pause": lambda api, c: api.pause(c),
    "rename": lambda api, c: api.rename(c, "listing-other"),
    "kill": lambda api, c: api.kill(c),
    "remove": lambda api, c: api.remove_container(c, force=True),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_change_of_a_moment_ago_is_seen_whether_its_event_has_come_or_not(engine, change):
    """Nothing follows the events here, so every one of them is late."""
    if change == "update" and engine.client.release.podman:
        pytest.skip("Podman 4 changes no container in place")
    known = {c.id: c for c in engine.list()}
    one = next(iter(known))
    CHANGES[change](engine.api(), one)
    found = {c.id: c for c in engine.list(known)}
    if change in ("kill", "remove"):
        assert one not in found or not found[one].alive
    else:
        assert found[one] == engine.inspect(one) != known[one]


def test_what_the_engine_refuses_has_a_kind(engine):
    with pytest.raises(EngineError) as found:
        engine.create("another", {"image": "rorg.test/none:1"}, {LABEL_OWNER: "listing"})
    assert (found.value.kind, found.value.remedy) == ("missing_image", "`rorg build`")
    with pytest.raises(EngineError) as found:
        engine.start("f" * 64)
    assert found.value.kind == "gone"
    assert engine.inspect("f" * 64) is None


def test_an_engine_that_is_not_there_is_unreachable(tmp_path):
    with pytest.raises(Unreachable, match="its socket is missing"):
        DockerEngine("me", f"unix://{tmp_path}/none.sock").ping()
    with pytest.raises(
        EngineError, match=r"ssh is not supported; try rorg on that machine, or DOCKER_HOST=tcp://robot:2376"
    ):
        DockerEngine("me", "ssh://me@robot:22").ping()


def test_a_connection_that_the_engine_has_closed_meanwhile_is_no_failure(dockerd):
    forwarder = Forwarder(dockerd.host)
    engine = DockerEngine("me", forwarder.host)
    assert engine.ping()
    before = engine.client._kept.connection.sock
    before.shutdown(socket.SHUT_RD)  # as if the other side had ended it
    assert engine.ping()
    assert engine.client._kept.connection.sock is not before
    forwarder.close()


@pytest.fixture
def silent():
    """An engine that says which it is, and nothing after that."""
    listener = socket.create_server(("127.0.0.1", 0))
    taken: list[socket.socket] = []

    def serve() -> None:
        with contextlib.suppress(OSError):
            while True:
                taken.append(listener.accept()[0])
                taken[-1].recv(4096)
                if len(taken) == 1:
                    taken[-1].sendall(b"HTTP/1.1 200 OK\r\nApi-Version: 1.41\r\nContent-Length: 0\r\n\r\n")

    threading.Thread(target=serve, daemon=True).start()
    yield f"tcp://127.0.0.1:{listener.getsockname()[1]}"
    for connection in (listener, *taken):
        connection.close()


def test_an_engine_that_does_not_answer_is_waited_for_and_no_longer(silent):
    engine = DockerEngine("me", silent)
    assert engine.client.release == Release(api=(1, 41))
    began = time.monotonic()
    with pytest.raises(TimedOut):
        engine.inspect("x" * 64, 0.2)
    assert 0.2 <= time.monotonic() - began < 10


def test_output_comes_whole_wherever_it_is_cut():
    frames = b"".join(bytes([1, 0, 0, 0, 0, 0, 0, len(t)]) + t for t in (b"one\n", b"", b"three\n"))
    for size in (1, 3, 7, 100):
        chunks = [frames[at : at + size] for at in range(0, len(frames), size)]
        taken = Frames()
        assert b"".join(t for chunk in chunks for t in taken.texts(chunk)) == b"one\nthree\n"


@pytest.fixture
def encrypted(dockerd, tmp_path):
    """The engine behind TLS that asks for a certificate, and the directory with the client's."""
    say = {"stdin": subprocess.DEVNULL, "capture_output": True, "check": True, "cwd": tmp_path}
    key = ["-newkey", "rsa:2048", "-nodes"]
    subprocess.run(
        [tool("openssl"), "req", "-x509", *key, "-keyout", "ca-key.pem", "-out", "ca.pem", "-subj", "/CN=tests"], **say
    )
    (tmp_path / "names").write_text("subjectAltName=IP:127.0.0.1")
    for name in ("server", "cert"):
        keyed = "key.pem" if name == "cert" else "server-key.pem"
        subprocess.run(
            [tool("openssl"), "req", *key, "-keyout", keyed, "-out", f"{name}.csr", "-subj", f"/CN={name}"], **say
        )
        sign = [tool("openssl"), "x509", "-req", "-in", f"{name}.csr", "-CA", "ca.pem", "-CAkey", "ca-key.pem"]
        subprocess.run([*sign, "-CAcreateserial", "-out", f"{name}.pem", "-extfile", "names"], **say)
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH, cafile=tmp_path / "ca.pem")
    context.load_cert_chain(tmp_path / "server.pem", tmp_path / "server-key.pem")
    context.verify_mode = ssl.CERT_REQUIRED
    plain, listener = Forwarder(dockerd.host), socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        while True:
            try:
                taken = context.wrap_socket(listener.accept()[0], server_side=True)
            except ssl.SSLError:
                continue  # a client without a certificate
            except OSError:
                return
            there = socket.create_connection(plain.listener.getsockname())
            threading.Thread(target=pump, args=(taken, there), daemon=True).start()
            threading.Thread(target=pump, args=(there, taken), daemon=True).start()

    threading.Thread(target=serve, daemon=True).start()
    yield f"tcp://127.0.0.1:{listener.getsockname()[1]}", tmp_path
    listener.close()
    plain.close()


def pump(here: socket.socket, there: socket.socket) -> None:
    try:
        while data := here.recv(1 << 16):
            there.sendall(data)
        there.shutdown(socket.SHUT_RDWR if isinstance(there, ssl.SSLSocket) else socket.SHUT_WR)
    except OSError:
        pass


def test_tls_is_told_by_docker_s_own_variables(encrypted, monkeypatch):
    host, certificates = encrypted
    monkeypatch.setenv("DOCKER_TLS_VERIFY", "1")
    monkeypatch.setenv("DOCKER_CERT_PATH", str(certificates))
    for name in ("REQUESTS_CA_BUNDLE", "CURL_CA_BUNDLE"):  # docker-py's own library goes by these first
        monkeypatch.delenv(name, raising=False)
    engine = DockerEngine("me", host)
    assert engine.ping() == f"{engine.client.release.product} {engine.api().version()['Version']}"
    (certificates / "cert.pem").unlink()
    with pytest.raises(Unreachable):
        DockerEngine("me", host).ping()
    (certificates / "ca.pem").unlink()
    with pytest.raises(Unreachable, match="certificate"):
        DockerEngine("me", host).ping()


def test_standard_input_ends_over_tls_while_output_goes_on(engine, encrypted, monkeypatch, tmp_path):
    """As over a unix socket: what a command says after the end of its input still comes."""
    host, certificates = encrypted
    monkeypatch.setenv("DOCKER_TLS_VERIFY", "1")
    monkeypatch.setenv("DOCKER_CERT_PATH", str(certificates))
    container, content = engine.list()[0].id, os.urandom(3 << 20)
    (tmp_path / "content").write_bytes(content)
    program = (
        "import sys\nfor chunk in iter(lambda: sys.stdin.buffer.read(9999), b''): sys.stdout.buffer.write(chunk)\n"
        "print('the end')"
    )
    client = "import sys\nfrom rorg.engines.docker.engine import DockerEngine\n"
    client += "sys.exit(DockerEngine('me', sys.argv[1]).attach(sys.argv[2], sys.argv[3:], False, True))"
    with (tmp_path / "content").open("rb") as file:
        done = subprocess.run(
            [sys.executable, "-c", client, host, container, "python3", "-S", "-c", program],
            stdin=file,
            capture_output=True,
            timeout=60,
        )
    assert done.stdout == content + b"the end\n", done.stderr
    assert done.returncode == 0


def test_a_stream_that_is_closed_ends(dockerd):
    client = Client(dockerd.host)
    with client.stream("GET", "/events") as stream:
        found: list[bytes] = []
        reading = threading.Thread(target=lambda: found.extend(stream.lines()))
        reading.start()
        stream.close()
        reading.join(20)
        assert not reading.is_alive()
    with pytest.raises(Refused), client.stream("GET", "/containers/none/logs", stdout=True):
        pass
    assert client.get("/version")["ApiVersion"] >= version_text(client.release.api), "the other calls go on"


def test_a_stream_of_events_that_the_engine_ends_leaves_no_thread(dockerd):
    """A robot sees many restarts of its engine in a year."""
    engine, stop, before = DockerEngine("streams", dockerd.host), Reading(), set(threading.enumerate())

    def left() -> list[threading.Thread]:
        return [t for t in threading.enumerate() if t not in before]

    for _ in range(3):
        for stream in (engine.events(stop), engine.object_events(stop)):
            next(stream)
            stream.close()
    try:
        wait_for(lambda: not left(), 60, "threads to end")
    finally:
        stop.set()


def test_a_stream_of_events_ends_when_it_is_told_to(dockerd):
    engine, stop, ended = DockerEngine("streams", dockerd.host), Reading(), []

    def follow(stream) -> None:
        ended.append(len(list(stream)))

    streams = [engine.events(stop), engine.object_events(stop)]
    for stream in streams:
        next(stream)
    threads = [threading.Thread(target=follow, args=[stream]) for stream in streams]
    for thread in threads:
        thread.start()
    stop.set()
    for thread in threads:
        thread.join(60)
    assert len(ended) == 2


def test_a_full_disk_of_the_engine_says_nothing_against_a_change():
    said = refusal("start nav", "failed to create shim task: write /run/x/init.pid: no space left on device")
    assert said.kind == "no_space"
    assert not failure(Action(0, Start(container="a"), "nav"), said).refused
