"""One machine of a robot has its certificate and answers the others as it likes. What they do together goes on."""

from __future__ import annotations

import itertools
import json
import socket
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import psutil
import pytest
from common import wait_for
from computers import Computer, Team
from hosts import Host, with_certificate
from rorg_client import Client, Error

SLEEP = {"image": "host", "command": "sleep infinity"}
SERVICES = {
    "tour": {**SLEEP, "machine": "base", "needs": ["localization"]},
    "localization": {**SLEEP, "machine": "head"},
    "camera": {**SLEEP, "machine": "bad"},
}
MOST_CPU = 0.25
"""Cores that rorg may use because of one machine that answers as fast as it can; unbounded it is more than one half."""
SHORTEST = 0.1
"""Seconds between two questions, on average, when many have been answered at once."""
Answer = Callable[[str, dict[str, Any]], Iterator[bytes]]
"""Path and renewal -> what is sent; the connection is closed if it sends no end."""


class Impostor(Host):
    """The machine `bad`. It counts the questions that it was asked."""

    def __init__(self, team: Team) -> None:
        self.answer: Answer = honest
        address = team.addresses["bad"]
        tls = with_certificate(team.folder / "certificates", "bad")
        super().__init__(lambda: iter(()), tls, int(address.rpartition(":")[2]))

    def serve(self, connection: socket.socket) -> None:
        with connection.makefile("rb") as asked:
            while line := asked.readline():
                length = 0
                while (header := asked.readline().strip()) != b"":
                    if header.lower().startswith(b"content-length:"):
                        length = int(header.partition(b":")[2])
                body = json.loads(asked.read(length) or b"{}")
                self.asked += 1
                for text in self.answer(line.split()[1].decode(), body):
                    connection.sendall(text)


def said(content: bytes) -> Iterator[bytes]:
    yield b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n" % len(content) + content


def honest(path: str, renewal: dict[str, Any], **more: Any) -> Iterator[bytes]:
    """Of both questions; `more`: fields of the answer that are others."""
    heard = [renewal.get("incarnation", 0), renewal.get("number", 0)]
    report = {"incarnation": 1, "version": 1, "heard": heard, "services": {}}
    given_up = renewal.get("takes", [])
    told = report if "report?" in path else {"incarnation": 1, "newest": heard, "released": given_up, "report": report}
    return said(json.dumps({**told, **more}).encode())


def number(text: str) -> Answer:
    """Claims to know an rorg of this incarnation."""
    return lambda path, renewal: said(b"".join(honest_text(path, renewal)).replace(b'"CLAIM"', text.encode()))


def honest_text(path: str, renewal: dict[str, Any]) -> Iterator[bytes]:
    return itertools.islice((t.partition(b"\r\n\r\n")[2] for t in honest(path, renewal, newest=["CLAIM", 1])), 1)


@pytest.fixture
def team(tmp_path) -> Iterator[Team]:
    made = Team(tmp_path, SERVICES, ("base", "head", "bad"))
    del made.computers["bad"]
    made.start()
    yield made
    made.down()


@pytest.fixture
def bad(team) -> Iterator[Impostor]:
    made = Impostor(team)
    goes_on(team)  # its services are started for the first time, when all machines agree
    yield made
    made.close()


def base(team: Team) -> Computer:
    return team.computers["base"]


def goes_on(team: Team) -> None:
    """A request reaches the third machine, and its release too."""
    base(team).ask("t1", "tour")
    base(team).wait("tour", timeout=20)
    base(team).client.release("t1")
    wait_for(lambda: team.computers["head"].state("localization") != "running", 20, "localization to stop")
    assert base(team).events("internal-error") == []


@pytest.mark.slow
@pytest.mark.parametrize("digits", ["9" * 4300, str(2**63 - 2), "1e400", '"' + "9" * 4000 + '"'])
def test_a_number_of_one_machine_means_nothing_to_the_others(team, bad, digits):
    asked = bad.asked
    bad.answer = number(digits)
    wait_for(lambda: bad.asked > asked + 3, 30, "some answers")
    goes_on(team)
    base(team).end()
    base(team).start()
    wait_for(lambda: base(team).link("head") == "up", 20, "the link to the third machine")
    goes_on(team)


@pytest.mark.slow
@pytest.mark.parametrize("more", [{"number": 2**63}, {"asking": [["camera", 1e400]]}, {"boot": "x" * 20_000}])
def test_a_renewal_out_of_bounds_is_refused(team, bad, more):
    files = team.folder / "certificates"
    named = {"cert": str(files / "bad.pem"), "key": str(files / "bad.key"), "ca": str(files / "authority.pem")}
    renewal = {"machine": "bad", "boot": "x", "incarnation": 1, "number": 1, "since": 1, "duration": 10, **more}
    with pytest.raises(Error, match="cannot read the request"):
        Client(f"https://{base(team).address}", **named).call("PUT", "/v1/machines/bad/renewal", renewal)
    goes_on(team)


@pytest.mark.slow
def test_wrong_answers_are_an_event_once_and_end_with_the_machine_that_gives_them(team, bad):
    bad.answer = lambda _path, _renewal: said(b"[" * 100_000)
    wait_for(lambda: base(team).events("link-refused"), 20, "the event")
    asked = bad.asked
    wait_for(lambda: bad.asked > asked + 3, 30, "more answers")
    assert len(base(team).events("link-refused")) == 1
    goes_on(team)
    bad.answer = honest
    wait_for(lambda: base(team).link("bad") == "up", 20, "the link to come back")


def news() -> Answer:
    """A later report at once, each time."""
    versions = itertools.count(2)
    return lambda path, renewal: honest(path, renewal, **({"version": next(versions)} if "report?" in path else {}))


def endless(text: bytes) -> Answer:
    return lambda _path, _renewal: itertools.repeat(text)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("answer", "burst"),
    [
        (honest, 40),
        (news(), 40),
        (endless(b"HTTP/1.1 100 Continue\r\n\r\n" * 100), 2),
        (endless(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n" + b"1\r\nx\r\n" * 10_000), 2),
    ],
    ids=["at once", "news at once", "continue", "chunks"],
)
def test_a_machine_that_answers_at_once_takes_little_of_a_core(team, bad, answer, burst):
    process, asked = psutil.Process(base(team).process.pid), bad.asked
    bad.answer = answer
    wait_for(lambda: bad.asked > asked + burst, 60, "what is answered in a burst")
    (began, used), asked = measured(process), bad.asked
    wait_for(lambda: bad.asked > asked + 8, 60, "more answers")
    now, cpu = measured(process)
    assert now - began > 8 * SHORTEST
    assert (cpu - used) / (now - began) < MOST_CPU
    goes_on(team)


def measured(process: psutil.Process) -> tuple[float, float]:
    times = process.cpu_times()
    return time.monotonic(), times.user + times.system


def drip(_path: str, _renewal: dict[str, Any]) -> Iterator[bytes]:
    yield b"HTTP/1.1 200 OK\r\nContent-Length: 100000\r\n\r\n"
    while True:
        time.sleep(0.1)
        yield b" "


@pytest.mark.slow
def test_an_answer_that_drips_has_a_deadline(team, bad):
    bad.answer = drip
    machines = partial(base(team).client.call, "GET", "/v1/machines")
    why = lambda: next(m["reason"] for m in machines() if m["name"] == "bad")  # noqa: E731
    wait_for(lambda: "does not answer" in why(), 30, "the link to say why it is lost")
    goes_on(team)
