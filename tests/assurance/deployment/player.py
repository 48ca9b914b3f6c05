"""Plays a week on a private Docker engine: `rorg run --git`, developers who push, visitors who come, and faults."""

from __future__ import annotations

import contextlib
import os
import subprocess
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from pathlib import Path

import commands
import docker
from common import free_port, wait_for
from deployment import tour_guide
from deployment.auditor import Auditor
from deployment.editions import Edition, Editions
from deployment.week import RESTARTED, Bad, Event, Kind
from dockerd import Dockerd
from forwarder import Forwarder
from git_origin import Origin
from rorg_client import Client, Error, Request
from rorg_process import RorgProcess

from rorg.tools.sim.generate import BEHAVIOUR

LIVE_RESTORE = ("--live-restore",)
POLL = "5s"
"""Between two fetches: 30 s on a robot."""
LEASE = 4.0
"""Seconds of the behaviour's request: after a restart it asks again within a third of that."""
NIGHT_LASTS = 120.0
"""Seconds at most until all is as asked for when nothing happens any more."""
TRIES = 10
"""To start the engine; its unit tries again and again."""
BUILT_WITHIN = 900.0
"""Seconds until all images are built, and all that is always on is ready."""
BAD_COMMAND, BAD_FIELD = {"command": ["no-such-program"]}, {"imgae": "x"}


class Asker(threading.Thread):
    """A program that keeps one request for what it needs at the moment, whatever becomes of rorg."""

    def __init__(self, client: Client, **more: str | float | None) -> None:
        """`more`: id, requester and lease of the request."""
        super().__init__(daemon=True)
        self.client, self.more = client, more
        self._wanted: tuple[str, ...] = ()
        self._asked: tuple[str, ...] = ()
        self._kept: Request | None = None
        self._changed, self._over = threading.Event(), threading.Event()

    def want(self, services: Sequence[str]) -> None:
        self._wanted = tuple(services)
        self._changed.set()

    def run(self) -> None:
        while not self._over.is_set():
            self._changed.wait(0.3)
            self._changed.clear()
            with contextlib.suppress(Error):
                if self._asked != (wanted := self._wanted):
                    self._ask(wanted)
                    self._asked = wanted

    def _ask(self, services: Sequence[str]) -> None:
        before = self._kept
        if services:
            self._kept = self.client.request(*services, **self.more)
            if before:
                before.abandon()
        elif before:
            before.release()
            self._kept = None

    def stop(self) -> None:
        self._over.set()
        if self._kept:
            self._kept.abandon()


class Player:
    """`folder` must have a short name, because of the sockets in it."""

    def __init__(self, folder: Path, dockerd: Dockerd) -> None:
        self.folder, self.dockerd, self.guide = folder, dockerd, tour_guide.tour_guide()
        self.ports = tour_guide.free_ports(self.guide.services)
        self.origin, self.editions = Origin(folder / "origin"), Editions(self.guide.services)
        self.numbers = Counter[str]()
        tour_guide.begin(self.guide, self.origin.clone / "robot", self.ports)
        self.origin.push("The tour guide")
        self.git, address = serve(folder / "origin")
        self.remote, self.engine = Forwarder(address), Forwarder(dockerd.host, at=folder / "engine.sock")
        self.rorg = RorgProcess(folder, {}, "--poll", POLL, docker=self.engine.host)
        url = self.remote.host.replace("tcp://", "git://")
        self.rorg.manifests = ["--git", f"{url}/origin.git@main", "--path", "robot"]
        client = self.rorg.client(timeout=5.0, patience=0.0)
        self.developer = Asker(client, id="autonomy", ttl=None)
        self.behaviour = Asker(client, id=BEHAVIOUR, requester=BEHAVIOUR, ttl=LEASE)
        self.auditor = Auditor(self.guide, self.ports, self.rorg, dockerd.host, self.editions)
        self.api, self.shift = docker.APIClient(dockerd.host, version="auto"), 0.0
        self.engineer, self.restarts = ThreadPoolExecutor(1), list[Future]()
        """Restarts the engine, beside all else. The engine ends with the thread that started it."""
        self.acts: dict[Kind, Callable[[Event], None]] = {
            Kind.ASKED: self.asks,
            Kind.NIGHT: self.night,
            Kind.SOFTWARE: self.updates,
            Kind.CONFIGURATION: self.updates,
            Kind.REVERT: self.reverts,
            Kind.KILL: self.kills,
            Kind.RORG_KILLED: lambda _: self.rorg.stop(kill=True),
            Kind.RORG_STARTED: lambda _: self.rorg.start() and None,
            **dict.fromkeys((Kind.ENGINE_KILLED, Kind.ENGINE_STOPPED, Kind.ENGINE_BARE), self.restarts_engine),
            Kind.ENGINE_CUT: lambda _: self.engine.cut(refuses=True),
            Kind.ENGINE_SILENT: lambda _: self.engine.cut(refuses=False),
            Kind.ENGINE_BACK: lambda _: self.engine.mend(),
            Kind.REMOTE_CUT: lambda _: self.remote.cut(refuses=True),
            Kind.REMOTE_BACK: lambda _: self.remote.mend(),
        }

    # -- the whole ---------------------------------------------------------------------------------------------

    def play(self, events: Sequence[Event], say: Callable[[str], None]) -> None:
        """From the moment at which all that is always on is ready, to a checkpoint after the last event."""
        self.rorg.start()
        always = sorted(self.guide.wanted(()))
        wait_for(lambda: Path(self.rorg.socket()).exists(), 300, "rorg")
        client = self.rorg.client(patience=60.0)
        wait_for(lambda: all(one["ready"] for one in client.readiness(*always).values()), BUILT_WITHIN, "the robot")
        self.developer.start()
        self.behaviour.start()
        self.auditor.start()
        for event in events:
            self.auditor.over.wait(max(0.0, event.at + self.shift - self.auditor.now))
            self._act(event, say)
        for event in after(events):
            self._act(event, say)
        self.auditor.stop()

    def _act(self, event: Event, say: Callable[[str], None]) -> None:
        at, outcome = self.auditor.now, ""
        try:
            self.acts[event.kind](event)
        except (AssertionError, OSError, Error, docker.errors.DockerException) as error:
            outcome = f"{type(error).__name__}: {error}"
        self.auditor.played(at, event, outcome)
        if event.kind is not Kind.ASKED:
            say(f"{at:7.1f} {event.kind} {event.service} {event.bad} {outcome}".rstrip())

    def close(self) -> None:
        self.developer.stop()
        self.behaviour.stop()
        self.auditor.stop()
        self.rorg.stop(kill=True)
        self.rorg.closed = True
        wait(self.restarts, 120)
        for listed in self.api.containers(all=True):  # by the engine: those that are paused outlive it, and a SIGKILL
            self.api.remove_container(listed["Id"], force=True)
        self.engine.close()
        self.remote.close()
        os.killpg(self.git.pid, 15)
        self.git.wait(30)
        self.engineer.shutdown()

    # -- visitors ----------------------------------------------------------------------------------------------

    def asks(self, event: Event) -> None:
        self.auditor.asked(event.state, (BEHAVIOUR, *event.services))
        self.developer.want((BEHAVIOUR,))
        self.behaviour.want(event.services)

    def night(self, event: Event) -> None:
        """Nothing is asked for, and nothing happens, until all is as it should be."""
        self.behaviour.want(())
        self.developer.want(())
        self.auditor.asked("night", ())
        wait(self.restarts, 120)
        began = self.auditor.now
        self.auditor.checkpoint(NIGHT_LASTS)
        words = ("image", "prune", "--yes", "--state-dir", str(self.rorg.state))
        commands.rorg(*words, timeout=120.0, DOCKER_HOST=self.engine.host)
        self.shift += max(0.0, self.auditor.now - began - 15.0)

    # -- developers --------------------------------------------------------------------------------------------

    def updates(self, event: Event) -> None:
        self.numbers[event.service] += 1
        self._push(event, self.editions.updated(event, self.numbers[event.service]))

    def reverts(self, event: Event) -> None:
        self._push(event, self.editions.reverted(event))

    def _push(self, event: Event, edition: Edition) -> None:
        name, bad = event.service, edition.bad
        more = BAD_COMMAND if bad is Bad.COMMAND else BAD_FIELD if bad is Bad.INVALID else {}
        text = tour_guide.manifest(self.guide, name, self.ports[name], edition.configuration, **more)
        said = f"{edition.software} {bad}" if bad in (Bad.EXITS, Bad.NEVER_READY) else str(edition.software)
        files = tour_guide.software(name, said) | {f"services/{name}.yaml": text}
        self.origin.push(f"{event.kind}: {name}", {f"robot/{path}": content for path, content in files.items()})
        self.editions.pushed(name, edition, self.auditor.last)

    # -- faults ------------------------------------------------------------------------------------------------

    def kills(self, event: Event) -> None:
        """Of the program, behind rorg's back."""
        labels = {"label": f"rorg.io/service={event.service}", "status": "running"}
        found = self.api.containers(filters=labels)
        assert found, "it does not run"
        self.api.kill(found[0]["Id"])

    def restarts_engine(self, event: Event) -> None:
        def restart() -> None:
            self.dockerd.stop(kill=event.kind is Kind.ENGINE_KILLED)
            self.dockerd.options = () if event.kind is Kind.ENGINE_BARE else LIVE_RESTORE
            start_engine(self.dockerd)

        self.restarts.append(self.engineer.submit(restart))


def start_engine(dockerd: Dockerd) -> None:
    for _ in range(TRIES):
        try:
            return dockerd.start()
        except (AssertionError, RuntimeError):  # a busy machine: its containerd, for one, has only 15 s
            dockerd.stop(kill=True)
    raise AssertionError("the engine does not start")


def after(events: Sequence[Event]) -> list[Event]:
    """What a part of a week must end with: what is still broken is mended, what is bad is reverted, and it is night."""
    end = events[-1].at
    lasting = ((Kind.RORG_KILLED, Kind.RORG_STARTED), (Kind.REMOTE_CUT, Kind.REMOTE_BACK))
    lasting += ((Kind.ENGINE_CUT, Kind.ENGINE_BACK), (Kind.ENGINE_SILENT, Kind.ENGINE_BACK))
    found = []
    for begins, ends in lasting:
        last = [event.kind for event in events if event.kind in (begins, ends)][-1:]
        found += [Event(end + RESTARTED, ends)] if last == [begins] else []
    reverted = Counter(event.service for event in events if event.kind is Kind.REVERT)
    for event in events:
        if event.bad and event.kind is not Kind.REVERT:
            reverted[event.service] -= 1
            if reverted[event.service] < 0:
                found.append(Event(end, Kind.REVERT, event.service, event.bad))
    return found + ([] if events[-1].kind is Kind.NIGHT else [Event(end, Kind.NIGHT)])


def serve(folder: Path) -> tuple[subprocess.Popen, str]:
    """A server of the repositories in a folder, and its address."""
    port = free_port()
    where = [f"--base-path={folder}", "--listen=127.0.0.1", f"--port={port}"]
    process = subprocess.Popen(["git", "daemon", *where, "--export-all", "--reuseaddr"], start_new_session=True)
    return process, f"tcp://127.0.0.1:{port}"
