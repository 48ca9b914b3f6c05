"""No acknowledged request is lost by a power cut, and none is back that was released. CUTS=50 for more than three."""

from __future__ import annotations

import json
import os
import random
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import wait_for
from guest import Guest
from robot import PERSON, Robot

CUTS = int(os.environ.get("CUTS") or 3)
CALLER = "runuser -u {person} -- /usr/lib/rorg/bin/python -I /tmp/caller.py {mark}"
FEW = 20
"""Acknowledged calls before each cut, at least."""


class Book:
    """What the requests must be, by what a caller said; id -> reason, None for no request."""

    def __init__(self) -> None:
        self.has: dict[str, str | None] = {}
        self.asked: dict[str, str | None] = {}
        """The call that was under way: whether it took effect is unknown."""
        self.calls = 0

    def note(self, line: str) -> None:
        kind, id, reason = json.loads(line)
        if kind == "asks":
            self.asked = {id: reason}
        else:
            self.has[id], self.asked = reason, {}
            self.calls += 1

    def problems(self, found: dict[str, str]) -> list[str]:
        """Requests that are not as they must be."""
        ids = sorted({*self.has, *self.asked, *found})
        return [
            f"{id}: acknowledged {self.has.get(id)}, asked {self.asked.get(id, '-')}, found {found.get(id)}"
            for id in ids
            if found.get(id) not in {self.has.get(id), self.asked.get(id, self.has.get(id))}
        ]


@pytest.fixture(scope="module")
def robot() -> Iterator[Robot]:
    guest = Guest("cuts")
    try:
        robot = Robot(guest, {"camera": {"idle": {"action": "pause"}}, "arm": {"needs": ["camera"]}, "hoarder": {}})
        guest.put(Path(__file__).parent / "caller.py", "/tmp/caller.py")
        yield robot
    finally:
        guest.close()


def requests(robot: Robot) -> dict[str, str]:
    return {request["id"]: request["reason"] for request in robot.json("get requests")}


def call_until_the_cut(robot: Robot, mark: str, book: Book, dice: random.Random) -> None:
    caller = robot.guest.popen(CALLER.format(person=PERSON, mark=mark))
    before, said = book.calls, list[str]()

    def read() -> None:
        for line in caller.stdout:
            said.append(line)
            if line.endswith("\n"):  # the cut may have torn the last one
                book.note(line)

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    wait_for(lambda: book.calls >= before + FEW or not reader.is_alive(), 120, "calls")
    assert reader.is_alive(), said[-20:]
    time.sleep(dice.uniform(0.0, 3.0))  # any moment of whatever rorg does
    robot.guest.cut()
    caller.wait(60)
    reader.join(60)


def test_the_book_finds_what_is_lost_and_what_is_back():
    book = Book()
    for line in ('["asks", "a", "1"]', '["has", "a", "1"]', '["asks", "b", "2"]', '["has", "b", "2"]'):
        book.note(line)
    assert book.problems({"a": "1", "b": "2"}) == []
    assert len(book.problems({"b": "2"})) == 1
    book.note('["asks", "b", null]')
    assert book.problems({"a": "1", "b": "2"}) == book.problems({"a": "1"}) == []
    book.note('["has", "b", null]')
    assert len(book.problems({"a": "1", "b": "2"})) == 1


def test_acknowledged_requests_survive_power_cuts(robot):
    """And the services that they name run again, and no others."""
    dice, book = random.Random(), Book()
    for cut in range(CUTS):
        call_until_the_cut(robot, f"{cut}", book, dice)
        robot.guest.boot()
        wait_for(lambda: robot.guest.run("systemctl is-active rorg")[0] == 0, 120, "rorg to run")
        found = requests(robot)
        assert book.problems(found) == []
        print(f"vm: cut {cut + 1}: {book.calls} calls were acknowledged so far, {len(found)} requests are held")
        asked = {service for request in robot.json("get requests") for service in request["services"]}
        wanted = asked | ({"camera"} if "arm" in asked else set())
        wait_for(lambda wanted=wanted: running(robot) == wanted, 120, f"{wanted} to run")
        book.has, book.asked = dict(found), {}
    for request in found:
        robot.rorg(f"release {request}")
    assert requests(robot) == {}


def running(robot: Robot) -> set[str]:
    return {service["service"] for service in robot.json("get") if service["state"] == "running"}
