"""Power cuts while a client requests and releases, and what must be there afterwards."""

from __future__ import annotations

import json
import random
import threading
import time

from common import wait_for
from vm.robot import PERSON, Robot

CALLER = "runuser -u {person} -- /usr/lib/rorg/bin/python -I /opt/caller.py {mark}"
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
    if dice.random() < 0.7:  # most often, one while a call is under way
        wait_for(lambda: book.asked or not reader.is_alive(), 60, "a call")
        time.sleep(dice.uniform(0.0, 0.1))
    robot.guest.cut(kept=dice.choice((0.0, 0.5, 0.9)))
    caller.wait(60)
    reader.join(60)


def check(robot: Robot, book: Book) -> None:
    """After the next boot: the requests are as the book says, and what they name runs, and nothing else."""
    wait_for(lambda: robot.guest.run(f"runuser -u {PERSON} -- rorg get")[0] == 0, 120, "rorg to answer")
    found = {request["id"]: request for request in robot.json("get requests")}
    assert book.problems({id: request["reason"] for id, request in found.items()}) == []
    wanted = {service for request in found.values() for service in request["services"]}
    wanted |= {"camera"} if "arm" in wanted else set()
    wait_for(lambda: robot.running() == wanted, 120, f"{wanted} to run")
    book.has, book.asked = {id: request["reason"] for id, request in found.items()}, {}
    print(f"vm: {book.calls} calls were acknowledged so far, {len(found)} requests are held", flush=True)
