"""Watches a week from outside: asks each service that must run for its edition, compares what runs with what is asked
for, and records what the engine and rorg did. Figures are made of this record, see figures.py."""

from __future__ import annotations

import contextlib
import json
import os
import re
import select
import socket
import threading
import time
from collections.abc import Iterable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import docker
import requests
from common import wait_for
from deployment.editions import Editions
from deployment.tour_guide import Guide
from deployment.week import Event
from histories import entries
from rorg_process import RorgProcess
from soak_samples import size

from rorg.core.observed import LABEL_SERVICE, LABEL_SPEC

EVERY, CHECKED, SAMPLED = 0.25, 2.0, 5.0
"""Seconds between two questions to services, two looks at containers, two samples of what rorg uses."""
ANSWERS = 0.25
"""Seconds for an answer."""
BOUND = 45.0
"""Seconds after which something that is not as asked for, and stays so, is wrong: more than a build that is tried
again, or a bad edition that never becomes ready, takes."""
ACTIONS = ("create", "start", "die", "destroy")
KINDS = ("update-failed", "crashed", "failed", "image-failed", "git-unreachable", "git-refused", "tree-refused")
KINDS += ("engine-lost", "engine", "stalled", "revision-failed", "internal-error", "runs-twice")
AWAY = (docker.errors.DockerException, requests.RequestException, OSError)
"""What a call of an engine that is away ends in."""


class Auditor:
    def __init__(
        self, guide: Guide, ports: Mapping[str, int], rorg: RorgProcess, host: str, editions: Editions
    ) -> None:
        self.guide, self.ports, self.rorg, self.host, self.editions = guide, ports, rorg, host, editions
        self.over, self.began = threading.Event(), time.time()
        self.wanted, self.last = guide.wanted(()), dict[str, str]()
        """Services that must run now, and what each said last."""
        self._said: dict[str, str] = {}
        self._differs: dict[tuple[str, bool, frozenset[str]], tuple[float, str]] = {}
        self.record: dict[str, list] = {
            name: [] for name in ("events", "asked", "answers", "runs", "wrong", "nights", "samples")
        }
        works = ((self._ask, EVERY), (self._check, CHECKED), (self._sample, SAMPLED))
        self._threads = [threading.Thread(target=self._steadily, args=work, daemon=True) for work in works]
        self._threads.append(threading.Thread(target=self._follow, daemon=True))

    @property
    def now(self) -> float:
        """Seconds since the week began."""
        return time.time() - self.began

    def start(self) -> None:
        self.began = time.time()
        self.asked("start", ())
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        if not self.over.is_set():
            self.over.set()
            self.record["journal"] = [*self._journal()]

    def _steadily(self, do: Any, every: float) -> None:
        while not self.over.wait(every):
            with contextlib.suppress(*AWAY):
                do()

    # -- what happens ------------------------------------------------------------------------------------------

    def asked(self, state: str, services: Iterable[str]) -> None:
        self.wanted = self.guide.wanted(services)
        self.record["asked"].append([round(self.now, 2), state, sorted(self.wanted)])

    def played(self, at: float, event: Event, outcome: str) -> None:
        self.record["events"].append([round(at, 2), event.kind, event.service, event.bad, event.state, outcome])

    # -- services answer ---------------------------------------------------------------------------------------

    def _ask(self) -> None:
        answers = answers_of({name: self.ports[name] for name in self.wanted})
        at = round(self.now, 2)
        for name, answer in answers.items():
            if answer != self._said.get(name):
                self.record["answers"].append([at, name, answer])
        self.last |= {name: answer for name, answer in answers.items() if answer}
        self._said = answers

    # -- what runs is what is asked for ------------------------------------------------------------------------

    def _check(self) -> None:
        """Notes what has differed for longer than BOUND while what is right for this service was the same."""
        now, found = self.now, self.differences()
        keys = {(name, name in self.wanted, self.editions.right.get(name, frozenset())): found[name] for name in found}
        for key, (since, text) in self._differs.items():
            if key not in keys and since + BOUND <= now:
                self.record["wrong"].append([round(since, 2), key[0], round(now - since, 1), text])
        self._differs = {key: (self._differs.get(key, (now, ""))[0], text) for key, text in keys.items()}

    def differences(self) -> dict[str, str]:
        """Service -> how it differs from what is asked for. Raises one of AWAY."""
        api = docker.APIClient(self.host, version="auto", timeout=10)
        there: dict[str, list[str]] = {}
        for listed in api.containers(all=True, filters={"label": LABEL_SERVICE}):
            there.setdefault(listed["Labels"][LABEL_SERVICE], []).append(listed["State"])
        wanted, said, right = self.wanted, self._said, self.editions.right
        found = {}
        for name in sorted({*self.guide.services, *there}):
            states = sorted(there.get(name, []))
            if name in wanted and (states != ["running"] or said.get(name) not in right[name]):
                found[name] = f"wanted as {sorted(right[name])}, is {states}, says '{said.get(name, '')}'"
            elif name not in wanted and ("running" in states or len(states) > 2):
                found[name] = f"not wanted, is {states}"
        return found

    def checkpoint(self, seconds: float) -> None:
        """Waits until nothing differs, and notes how long that took, and what still differs after so many seconds."""
        began, left = self.now, {"engine": "away"}

        def right() -> bool:
            nonlocal left
            with contextlib.suppress(*AWAY):
                left = self.differences()
            return not left or self.over.wait(0.5)

        with contextlib.suppress(AssertionError):
            wait_for(right, seconds)
        self.record["nights"].append([round(began, 2), round(self.now - began, 1), left])

    # -- what the engine and rorg did --------------------------------------------------------------------------

    def _follow(self) -> None:
        """Events of containers. An engine that was restarted still knows those since its start."""
        seen, last = set(), self.began
        while not self.over.wait(0.1):
            with contextlib.suppress(*AWAY):
                api = docker.APIClient(self.host, version="auto")
                for event in api.events(since=int(last), decode=True, filters={"type": "container"}):
                    key, last = (event["timeNano"], event["id"], event["Action"]), event["timeNano"] / 1e9
                    if key not in seen and event["Action"] in ACTIONS:
                        seen.add(key)
                        about = event["Actor"]["Attributes"]
                        told = [event["Action"], about.get(LABEL_SERVICE, ""), event["id"][:12]]
                        digest = about.get(LABEL_SPEC, "")[:12]
                        self.record["runs"].append([round(last - self.began, 2), *told, digest])

    def _journal(self) -> Iterable[list]:
        for entry in entries(self.rorg.state / "journal.db"):
            at = datetime.fromisoformat(entry["at"]).timestamp() - self.began
            if entry["kind"] in KINDS and at > 0:
                yield [round(at, 2), entry["kind"], entry.get("service", ""), entry["message"][:160]]

    def _sample(self) -> None:
        """What rorg uses: PSS, journal and state directory in MB; and its containers and images."""
        process, api = self.rorg.process, docker.APIClient(self.host, version="auto", timeout=10)
        rollup = Path(f"/proc/{process.pid}/smaps_rollup").read_text()
        memory = int(re.search(r"^Pss:\s+(\d+)", rollup, re.MULTILINE)[1]) / 1024
        state = self.rorg.state
        told = (memory, size(state.glob("journal.db*")), size(state.rglob("*")))
        counts = len(api.containers(all=True)), len(api.images(quiet=True))
        load = os.getloadavg()[0]
        self.record["samples"].append([round(self.now, 1), *(round(value, 2) for value in (*told, *counts, load))])


def answers_of(ports: Mapping[str, int]) -> dict[str, str]:
    """Service -> what it says; empty if it does not answer in time. All are asked together."""
    found, poll, asked = dict.fromkeys(ports, ""), select.poll(), {}
    for name, port in ports.items():
        connection = socket.socket()
        connection.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            connection.connect(("127.0.0.1", port))
        asked[connection.fileno()] = name, connection
        poll.register(connection, select.POLLIN)
    deadline = time.monotonic() + ANSWERS
    while asked and (left := deadline - time.monotonic()) > 0:
        for descriptor, _ in poll.poll(left * 1000):
            name, connection = asked.pop(descriptor)
            poll.unregister(descriptor)
            with contextlib.suppress(OSError), connection:
                found[name] = connection.recv(100).decode().strip()
    for _, connection in asked.values():
        connection.close()
    return found


def save(record: Mapping[str, Any], path: Path) -> None:
    """As JSON with a line for each entry."""
    parts = []
    for name, value in record.items():
        rows = ",\n".join(f"  {json.dumps(row)}" for row in value) if isinstance(value, list) else ""
        parts.append(f" {json.dumps(name)}: " + (f"[\n{rows}\n ]" if rows else json.dumps(value)))
    path.write_text("{\n" + ",\n".join(parts) + "\n}\n")
