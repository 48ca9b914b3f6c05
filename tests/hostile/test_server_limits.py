"""Callers that want everything for themselves: others are answered meanwhile, memory stays bounded, rorg ends when it
is told to, and all is right once they are gone."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import ssl
import time
from concurrent.futures import Future
from inspect import iscoroutinefunction
from statistics import median

import psutil
import pytest
from common import wait_for
from floods import FLOODS, answer, asking, connect, flood
from histories import owned, write_many
from limited_server import FILES, beside, robot  # noqa: F401
from robots import RealRobot

from rorg.api import limits
from rorg.api.cpu_share import in_threads
from rorg.api.limits import Account
from rorg.client import Client, NotReady, Refused
from rorg.core.requests import mistakes, problems
from rorg.errors import TooMany
from rorg.model.catalog import Catalog, Request, Service
from rorg.store import requests_limits
from rorg.store.committer import MOST_OF_ONE, Turns


def over_tls(robot) -> dict:  # noqa: F811
    context = ssl.create_default_context(cafile=str(robot.folder / "ca.pem"))
    context.load_cert_chain(robot.folder / "laptop.pem", robot.folder / "laptop.key")
    plain = socket.create_connection(("127.0.0.1", robot.port), timeout=20)
    with context.wrap_socket(plain, server_hostname="127.0.0.1") as connection:
        connection.sendall(asking("GET", "/v1/services/camera"))
        return json.loads(answer(connection).partition(b"\r\n\r\n")[2])


@contextlib.contextmanager
def many(count: int, opening):
    """So many connections that stay; those that are hung up on at once count too."""
    with contextlib.ExitStack() as all_of_them:
        found = []
        for _ in range(count):
            with contextlib.suppress(OSError):
                found.append(all_of_them.enter_context(opening()))
        yield found


# -- too many ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_silent_peers_on_tcp_take_no_descriptor_that_the_loop_needs(robot):  # noqa: F811
    client = robot.client(patience=20)
    with many(FILES + 100, lambda: socket.create_connection(("127.0.0.1", robot.port))):
        before = client.service("gamma")
        robot.kill_service(before["pid"])
        wait_for(lambda: client.service("gamma")["incarnation"] not in ("", before["incarnation"]), 30)
        assert over_tls(robot)["service"] == "camera"
        robot.others()
        assert psutil.Process(robot.process.pid).num_fds() < limits.room(FILES)
    robot.others()


@pytest.mark.slow
def test_nobody_gets_more_than_half_of_the_room_that_is_left(robot):  # noqa: F811
    alpha, gamma = (lambda n=name: connect(robot.socket(n)) for name in ("alpha", "gamma"))
    with many(250, alpha), many(250, gamma), many(250, lambda: connect(robot.socket())):
        robot.others()
        assert psutil.Process(robot.process.pid).num_fds() < FILES - 50
    robot.client("alpha", patience=20).services()


def test_out_of_descriptors_it_goes_on_when_there_are_some_again(robot):  # noqa: F811
    process = psutil.Process(robot.process.pid)
    robot.others()
    wait_for(lambda: robot.client().service("camera")["state"] != "running")
    process.rlimit(psutil.RLIMIT_NOFILE, (process.num_fds() + 2, FILES))
    try:
        with many(20, lambda: connect(robot.socket())):
            began = sum(process.cpu_times()[:2])
            time.sleep(1.0)
            assert sum(process.cpu_times()[:2]) - began < 0.7, "it does not try without a pause"
    finally:
        process.rlimit(psutil.RLIMIT_NOFILE, (FILES, FILES))

    def right() -> bool:
        with contextlib.suppress(NotReady):
            robot.others()
            return True
        return False

    wait_for(right, 30)


@pytest.mark.parametrize(
    ("descriptors", "room"), [(64, 32), (1024, 512), (4096, 3584), (65536, limits.MOST_CONNECTIONS)]
)
def test_the_loop_has_descriptors_of_its_own(descriptors, room):
    assert limits.room(descriptors) == room


# -- too much ----------------------------------------------------------------------------------------------------

HEAD = b"GET /v1/services HTTP/1.1\r\nhost: x\r\n"


@pytest.mark.parametrize(
    ("said", "status"),
    [
        (b"GET /" + b"x" * 40_000 + b" HTTP/1.1\r\nhost: x\r\n\r\n", b"431"),
        (HEAD + b"a: " + b"x" * 60_000, b"431"),
        (HEAD + b"a: b\r\n" * 70 + b"\r\n", b"431"),
        (b"\x16\x03\x01\x00\x00", b"400"),
        (asking("PUT", "/v1/requests/x", content_length=str(2 << 20)), b"413"),
        (asking("PUT", "/v1/requests/x", transfer_encoding="chunked"), b"413"),
    ],
    ids=["path", "header", "headers", "no HTTP", "body", "chunks"],
)
def test_what_is_too_much_is_refused_in_words(robot, said, status):  # noqa: F811
    with connect(robot.socket("alpha")) as connection:
        connection.sendall(said)
        head, _, body = answer(connection).partition(b"\r\n\r\n")
    assert head[9:12] == status
    assert json.loads(body)["code"] in ("too-large", "invalid")
    robot.others()


def test_requests_that_wait_behind_others_are_few(robot):  # noqa: F811
    with connect(robot.socket("alpha")) as connection:
        wait = asking("GET", "/v1/wait?services=other-1&timeout=20")
        connection.sendall(wait + HEAD.join([b"", *[b"\r\n"] * 50]))
        assert answer(connection) == b""
    with connect(robot.socket("alpha")) as connection:
        connection.sendall((HEAD + b"\r\n") * 3)
        assert b"200" in answer(connection)[:12]
    robot.others()


def test_a_refused_body_without_end_is_hung_up_on(robot):  # noqa: F811
    with connect(robot.socket("alpha")) as connection:
        connection.sendall(asking("PUT", "/v1/requests/x", content_length=str(1 << 40)))
        with pytest.raises(ConnectionError):
            connection.sendall(b"x" * (100 << 20))
    robot.others()


@pytest.mark.slow
def test_bodies_that_never_end_are_few(robot):  # noqa: F811
    """Of one service; each is kept as far as it has come."""
    half = asking("PUT", "/v1/manifests/Service/x", content_length=str(limits.MOST_BODY)) + b" " * 900_000

    def opening() -> socket.socket:
        connection = connect(robot.socket("alpha"))
        connection.settimeout(1)
        with contextlib.suppress(OSError):
            connection.sendall(half)
        return connection

    with many(60, opening):
        robot.others()


@pytest.mark.slow
@pytest.mark.parametrize("path", ["/v1/services", "/v1/events?cursor=0", "/v1/events?cursor=0&follow=true"])
def test_answers_that_nobody_reads_are_not_kept(robot, path):  # noqa: F811
    with many(100, lambda: connect(robot.socket("alpha"))) as deaf:
        for connection in deaf:
            with contextlib.suppress(OSError):
                connection.sendall(asking("GET", path) * (4 if "events" not in path else 1))
        robot.others()
    robot.others()


def test_all_of_a_long_journal_is_told_to_who_reads_it(robot):  # noqa: F811
    told = [entry["seq"] for entry in robot.client(timeout=60).events(cursor=0)]
    assert told == list(range(1, told[-1] + 1))
    assert told[-1] > 12000


# -- too often ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["reads", "changes", "unknown names", "no HTTP"])
def test_a_service_that_floods_is_told_to_wait_and_others_are_not(robot, kind):  # noqa: F811
    said, began = robot.log(), time.monotonic()
    with flood(robot.socket("alpha"), FLOODS[kind]) as statuses:
        wait_for(lambda: kind in ("no HTTP", "reads") or 429 in statuses, 30)
        robot.others()
    # What is let through is told, so many lines a second.
    assert robot.log() - said < 40_000 + 4_000 * (time.monotonic() - began)
    assert set(statuses) <= {200, 204, 400, 409, 422, 429}
    with connect(robot.socket("alpha")) as connection:
        wait_for(lambda: (connection.sendall(FLOODS["reads"](0)), answer(connection)[9:12] == b"200")[1], 10)


def test_who_asks_too_often_hears_when_to_come_again(robot):  # noqa: F811
    def asked() -> bytes:
        connection.sendall(FLOODS["reads"](0))
        return answer(connection)

    with flood(robot.socket("alpha"), FLOODS["changes"]) as statuses, connect(robot.socket("alpha")) as connection:
        wait_for(lambda: 429 in statuses, 30)
        told = wait_for(lambda: (found := asked())[9:12] == b"429" and found, 30)
    head, _, body = told.partition(b"\r\n\r\n")
    assert int(head.lower().partition(b"retry-after: ")[2].split(b"\r\n")[0]) in (1, 2, 3)
    assert json.loads(body)["code"] == "too-many-requests"
    assert "its share of rorg" in json.loads(body)["cause"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["reads", "changes"])
def test_a_request_is_acted_on_nearly_as_soon_beside_a_flood(robot, kind):  # noqa: F811
    """In turns, so that both have the same machine. What is left for chance is much, since a machine whose cores are
    busy makes both wait for their turn (tests/bench has the figure)."""
    quiet, loud = beside(robot, kind, rounds=3, each=6)
    assert median(loud) < 4 * median(quiet) + 0.5


def test_what_speaks_no_tls_is_not_logged(robot):  # noqa: F811
    said = robot.log()
    for _ in range(100):
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", robot.port)) as connection:
            connection.sendall(os.urandom(300))
            connection.shutdown(socket.SHUT_WR)  # some bytes announce more, for which rorg would wait
            connection.recv(100)
    assert over_tls(robot)["service"] == "camera"
    assert robot.log() - said < 5000, "a line of each would be more"


@pytest.mark.slow
def test_a_handshake_that_does_not_end_is_ended(robot):  # noqa: F811
    with socket.create_connection(("127.0.0.1", robot.port), timeout=limits.HANDSHAKE + 20) as connection:
        assert connection.recv(100) == b""


@pytest.mark.slow
def test_it_ends_at_once_whoever_calls(robot):  # noqa: F811
    """The last one: the others share this rorg."""
    silent = many(100, lambda: socket.create_connection(("127.0.0.1", robot.port)))
    with silent, flood(robot.socket("alpha"), FLOODS["changes"]), flood(robot.socket("gamma"), FLOODS["reads"]):
        robot.others()
        began = time.monotonic()
        robot.stop()
        assert time.monotonic() - began < 5
    robot.start()
    robot.others()


# -- too slow ----------------------------------------------------------------------------------------------------


@pytest.fixture
def near(tmp_path):
    found = RealRobot(tmp_path, "process", None, with_server=True)
    found.declare({"alpha": {"may_request": ["camera"]}, "camera": {}})
    wait_for(lambda: found.client(patience=20).services() and os.path.exists(found.socket("alpha")))
    yield found
    found.close()


@pytest.mark.parametrize("begins", [HEAD, asking("PUT", "/v1/requests/x", content_length="9999")], ids=["head", "body"])
def test_a_request_that_comes_byte_by_byte_is_hung_up_on(near, monkeypatch, begins):
    monkeypatch.setattr(limits, "COMPLETE", 0.5)

    def another(connection: socket.socket) -> bool:
        connection.sendall(b"x")
        return False

    with connect(near.socket("alpha")) as connection:
        connection.sendall(begins)
        with pytest.raises(ConnectionError):
            wait_for(lambda: another(connection), 20)
    near.client().services()


def test_who_does_not_read_is_hung_up_on(near, monkeypatch):
    monkeypatch.setattr(limits, "DEAF", 0.3)
    journal, message = near.loop.recorder.journal, "x" * 1000
    with connect(near.socket()) as connection:
        connection.sendall(asking("GET", "/v1/events?follow=true"))
        wait_for(lambda: journal._followers)
        for _ in range(2000):
            journal.append("now", "told", message)
        wait_for(lambda: not journal._followers, what="it is hung up on")
    assert near.server.accounts._one("uid 0", limits.UNLIMITED).unread == 0


def test_streams_that_nobody_listens_to_any_more_end_and_are_charged(near, monkeypatch):
    journal, account = near.loop.recorder.journal, near.server.accounts.of_service("alpha")
    account.charge(0.0)
    began = account._left
    monkeypatch.setattr(account, "clock", lambda: account._at)  # nothing is given back meanwhile
    for _ in range(5000):
        journal.append("now", "told", "x" * 300, service="alpha")
    with many(30, lambda: connect(near.socket("alpha"))) as deaf:
        for connection in deaf:
            connection.sendall(asking("GET", "/v1/events?cursor=0&follow=true"))
        wait_for(lambda: len(journal._followers) == len(deaf))
        wait_for(lambda: account.unread > 0)
    wait_for(lambda: not near.server.uvicorn.server_state.tasks, 10)
    assert account._left < began - 30 * limits.CALL - 30 * limits.GREETING - 0.01


# -- what is counted, and whose turn it is -------------------------------------------------------------------------


def test_what_works_in_threads_is_known(near):
    """It is charged by its time, since no step of it is seen."""
    unseen = [r.path for r in near.server.app.routes if hasattr(r, "dependant") and not iscoroutinefunction(r.endpoint)]
    assert unseen
    assert all(map(in_threads, unseen))


def test_one_requester_cannot_make_the_file_of_all_large(near, monkeypatch):
    monkeypatch.setattr(requests_limits, "MOST_NAMED", 3)
    client = near.client()
    client.request("camera", "alpha", id="first", ttl=None)
    with pytest.raises(Refused, match="name 2 services already"):
        client.request("camera", "alpha", id="second", ttl=None)
    client.request("camera", id="second", ttl=None)
    client.request("alpha", "camera", id="first", ttl=None)


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_a_share_is_used_up_and_comes_back():
    clock = Clock()
    account = Account("alpha", limits.SHARE, clock)
    account.charge(limits.BURST)
    assert account.owed() == 0.0
    account.charge(0.01)
    assert account.owed() == pytest.approx((limits.SPARE + 0.01) / limits.SHARE)
    clock.now += account.owed() / 2
    assert account.owed() > 0, "not before something is saved up"
    clock.now += account.owed() + 1e-9
    assert account.owed() == 0.0
    account.charge(1000.0)
    assert account.owed() <= 2.25 + 1e-9, "it never waits for long"
    clock.now += 1000
    account.charge(limits.BURST + 0.01)
    assert account.owed() > 0, "no more is saved up than BURST"


def test_people_have_no_share_and_services_few_bytes_at_once():
    person, service = Account("uid 0", limits.UNLIMITED, Clock()), Account("alpha", limits.SHARE, Clock())
    person.charge(1e9)
    assert person.owed() == 0.0
    with service.reading(limits.MOST_HELD):
        with pytest.raises(TooMany), service.reading(1):
            pass
        with person.reading(limits.MOST_HELD), person.reading(limits.MOST_HELD):
            pass
    with service.reading(limits.MOST_HELD):
        pass


def test_changes_have_turns():
    """However many of one caller wait; each one's stay in their order."""
    turns = Turns()
    for number in range(1000):
        turns.put("hostile", (number, Future()))
    turns.put("other", ("a", Future()))
    turns.put("other", ("b", Future()))
    first = [what for what, _ in turns.take()]
    assert set(first[:4]) == {0, 1, "a", "b"}
    assert len(first) == MOST_OF_ONE + 2
    rest = [what for batch in iter(turns.take, []) for what, _ in batch]
    assert [n for n in first + rest if isinstance(n, int)] == list(range(1000))
    assert not turns


def test_many_unknown_names_cost_little():
    names = [f"service-number-{n}" for n in range(300)]
    catalog = Catalog(services={name: Service(name) for name in [*names, "developer"]})
    asked = Request("x", "developer", tuple(f"service-nomber-{n}" for n in range(299)))
    began = time.thread_time()
    found = mistakes(catalog, asked)
    assert time.thread_time() - began < 0.5
    assert found == problems(catalog, (), asked)
    assert found[0].remedy.startswith("'service-number-")
    assert found[-1].cause == "289 more unknown services"


def test_a_line_of_a_long_journal_is_found_at_once(tmp_path):
    path = tmp_path / "journal.db"
    write_many(path, 20_000, message="x" * 100)
    journal = owned(path)
    began = time.thread_time()
    for after in range(0, 18_000, 1000):
        assert [e["seq"] for e in journal.after(after, 3)][-1] == after + 3
    assert time.thread_time() - began < 1.0
    assert journal.after(20_000, 3) == []
    assert [e["seq"] for e in journal.after(19_999, 3)] == [20_000]


@pytest.mark.slow
def test_a_person_is_never_told_to_wait(near):
    client = Client(near.socket(), patience=0.0)
    for _ in range(50):
        with client.request("camera", id="tour", ttl=None):
            pass
    assert not [line for line in near.lines if "share" in line]


@pytest.mark.slow
def test_a_service_that_requests_and_releases_200_times_in_a_row_never_waits(near):
    with near.client().request("alpha", wait=30):
        client = Client(near.socket("alpha"), patience=0.0)
        for _ in range(200):
            with client.request("camera", id="tour", ttl=None):
                pass
    assert not [line for line in near.lines if "share" in line]
