"""Follows the events of the engine, across its restarts, for the judge."""

from __future__ import annotations

import contextlib
import threading
import time
from dataclasses import replace

import docker
import requests
from soak_random.judge import Event
from soak_random.robot import LABEL

from rorg.core.observed import LABEL_SERVICE
from rorg.model.units import parse_time

AWAY = (docker.errors.DockerException, requests.RequestException, OSError, ValueError)
"""What a call of an engine that is away ends in."""
ACTIONS = ("start", "die", "pause", "unpause", "kill", "destroy")
RUNNING = ("die", "pause", "unpause", "kill")
"""What happens only to a container that runs; one that has ended is removed, too."""


class Witness:
    def __init__(self, host: str) -> None:
        self.host, self.began = host, time.time()
        self.events: dict[tuple[float, str, str], Event] = {}
        self._guessed: dict[str, Event] = {}
        """Ends that no event told, by container."""
        self._down = self.began
        """When the engine was last known to answer, before it was stopped."""
        self._lock, self._over = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._api: docker.APIClient | None = None

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._over.set()
        if self._api is not None:
            with contextlib.suppress(*AWAY):
                self._api.close()

    def known(self) -> list[Event]:
        with self._lock:
            return sorted(self.events.values())

    def add(self, event: Event) -> None:
        with self._lock:
            self.events[event.at, event.container, event.action] = event

    def engine_ended(self) -> None:
        """The engine is about to be stopped: what ends from now on ends without an event."""
        self._down = time.time()

    # -- the stream --------------------------------------------------------------------------------------------

    def _follow(self) -> None:
        """An engine that goes on tells what was missed; one that was started again is looked at."""
        last = self.began
        while not self._over.wait(0.05):
            with contextlib.suppress(*AWAY):
                self._api = api = docker.APIClient(self.host, version="auto")
                stream = api.events(since=int(last) - 2, decode=True, filters={"type": "container"})
                self._look(api)
                for event in stream:
                    last = max(last, event["timeNano"] / 1e9)
                    self._hear(event)

    def _hear(self, event: dict) -> None:
        about = event["Actor"]["Attributes"]
        if event["Action"] in ACTIONS and LABEL_SERVICE in about:
            at, edition = event["timeNano"] / 1e9, int(about.get(LABEL) or 0)
            told = at, event["Action"], event["id"], about[LABEL_SERVICE], edition, about.get("signal", "")
            with self._lock:
                guess = self._guessed.pop(event["id"], None)
                if guess and event["Action"] in RUNNING:  # it went on, and ended only now
                    self.events.pop((guess.at, guess.container, guess.action), None)
            self.add(Event(*told))

    def _look(self, api: docker.APIClient) -> None:
        """Adds what no event told. A run may have ended as early as the engine did, which excuses most."""
        known, runs = self.known(), dict[str, Event]()
        for event in known:
            if event.action == "start":
                runs[event.container] = event
            elif event.action in ("die", "destroy"):
                runs.pop(event.container, None)
        there: dict[str, dict] = {}
        for listed in api.containers(all=True, filters={"label": LABEL_SERVICE}):
            with contextlib.suppress(docker.errors.NotFound):
                there[listed["Id"]] = api.inspect_container(listed["Id"])
        for container, event in runs.items():
            if event.at < self._down and not _goes_on(event, there.get(container)):
                guess = replace(event, at=max(self._down, event.at), action="die")
                self._guessed[container] = guess
                self.add(guess)
        for container, found in there.items():
            labels, begun = found["Config"]["Labels"], runs.get(container)
            if found["State"]["Running"] and not (begun and _goes_on(begun, found)):
                about = container, labels[LABEL_SERVICE], int(labels.get(LABEL) or 0)
                self.add(Event(parse_time(found["State"]["StartedAt"]), "start", *about))

    def states(self) -> dict[str, list[tuple[str, int]]]:
        """Service -> (state, edition) of each of its containers, now. Raises one of AWAY."""
        api = docker.APIClient(self.host, version="auto", timeout=20)
        found: dict[str, list[tuple[str, int]]] = {}
        for listed in api.containers(all=True, filters={"label": LABEL_SERVICE}):
            labels = listed["Labels"]
            found.setdefault(labels[LABEL_SERVICE], []).append((listed["State"], int(labels.get(LABEL) or 0)))
        return found


def _goes_on(event: Event, inspected: dict | None) -> bool:
    """Whether a container is still in the run that began with this event: the engine notes a start before it tells."""
    state = inspected and inspected["State"]
    return bool(state and state["Running"] and parse_time(state["StartedAt"]) < event.at + 0.01)
