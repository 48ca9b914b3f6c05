"""What the random soak does: requests, in threads of their own, and all else, one after another."""

from __future__ import annotations

import contextlib
import random
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator

import commands
import docker
from deployment.player import start_engine
from dockerd import Dockerd
from rorg_client import Client, Error, Invalid, NotFound, NotReady, Refused, calls
from soak_random.book import Asked, Book
from soak_random.judge import Hand, Span
from soak_random.robot import CRASHES, GOOD, GROUPS, MOUNTING, REFUSED, SERVICES, SILENT, Rorg
from soak_random.witness import AWAY, Witness

from rorg.core.observed import LABEL_SERVICE

STEPS = (-3600.0, -20.0, 0.0, 20.0, 3600.0)
"""Seconds by which the clock of rorg is off."""
WAIT, LEASE = 15.0, 5.0
HAND = ("stop", "kill", "rm", "pause", "unpause", "start", "restart")


class Requester(threading.Thread):
    """Requests, replaces and releases its own ids."""

    def __init__(self, number: int, rorg: Rorg, book: Book, seed: int) -> None:
        super().__init__(daemon=True)
        self.number, self.rorg, self.book = number, rorg, book
        self.dice = random.Random(f"{seed} {number}")
        self.client, self.process = rorg.client(timeout=30.0, patience=60.0), rorg.process
        self.may, self.idle, self.over = threading.Event(), threading.Event(), threading.Event()

    def run(self) -> None:
        while not self.over.wait(self.dice.uniform(0.1, 1.5)):
            self.idle.set()
            if self.may.wait(0.5):
                self.idle.clear()
                self.step(f"r{self.number}-{self.dice.randrange(3)}")

    def step(self, id: str) -> None:
        with self.book.lock:
            self.book.unknown.add(id)
        try:
            if self.dice.random() < 0.3:
                self.client.release(id)
                self._acknowledged(id, None)
            else:
                self._request(id)
            self.book.count("request")
        except (Error, OSError) as error:
            self.book.count("request without an answer")
            self.book.errors.append(f"{type(error).__name__}: {error}")

    def _request(self, id: str) -> None:
        names = self.dice.sample([*SERVICES, *GROUPS], self.dice.choice((1, 1, 1, 2, 3)))
        ttl = self.dice.choice((None, None, LEASE))
        body = {"services": names, "priority": self.dice.choice((None, None, 70)), "ttl": calls.duration(ttl or 0)}
        body |= {} if ttl else {"ttl": None}
        wait = WAIT if self.dice.random() < 0.7 else None
        asked, self.process = time.time(), self.rorg.process
        if ttl is None and self.dice.random() < 0.15:
            return self._command(id, names, asked)
        try:
            self.client.do(calls.put_request(id, body, None, wait))
            if wait:
                self.book.ready(asked, names, f"request {id} {names} with wait")
        except NotReady:
            pass  # it stands
        except (Refused, Invalid, NotFound):
            return self._unchanged(id)
        # The lease counts from when it arrived, or from a later start of rorg.
        self._acknowledged(id, Asked(tuple(names), asked + ttl if ttl else None))

    def _command(self, id: str, names: list[str], asked: float) -> None:
        """The same as a person does it."""
        words = ["request", *names, "--id", id, "--wait", "--timeout", f"{WAIT:g}s"]
        done = commands.run(words, self.rorg.environment(), timeout=120.0)
        if done.returncode == 0:
            self.book.ready(asked, names, f"rorg {' '.join(words)}")
        if done.returncode in (0, 4):
            self._acknowledged(id, Asked(tuple(names)))
        elif done.returncode in (2, 5):
            self._unchanged(id)
        else:
            self.book.errors.append(f"exit {done.returncode}: {done.stderr}")

    def _unchanged(self, id: str) -> None:
        """It was refused. But an rorg that was killed may have done it before the client repeated the call."""
        if self.process is not self.rorg.process:
            return
        with self.book.lock:
            self.book.unknown.discard(id)

    def _acknowledged(self, id: str, asked: Asked | None) -> None:
        with self.book.lock:
            self.book.unknown.discard(id)
            self.book.requests.pop(id, None)
            if asked:
                self.book.requests[id] = asked


class Actor:
    """Does the rest, in the main thread: the engine and rorg end with the thread that started them."""

    def __init__(self, rorg: Rorg, dockerd: Dockerd, book: Book, witness: Witness, seed: int) -> None:
        self.rorg, self.dockerd, self.book, self.witness = rorg, dockerd, book, witness
        self.tree, self.dice, self.number = book.tree, random.Random(seed), 0
        self.client: Client = rorg.client(timeout=30.0, patience=60.0)
        self.api = docker.APIClient(dockerd.host, version="auto", timeout=30)
        self.choices: dict[Callable[[], None], int] = {
            self.edit: 14,
            self.edit_file: 7,
            self.commit: 8,
            self.revert: 3,
            self.rollback: 3,
            self.hold: 4,
            self.end_hold: 3,
            self.retry: 3,
            self.restart: 4,
            self.by_hand: 22,
            self.end_rorg: 3,
            self.end_engine: 2,
            self.freeze: 4,
            self.step_clock: 2,
        }

    def act(self) -> str:
        """Does one thing; returns its name."""
        action = self.dice.choices([*self.choices], [*self.choices.values()])[0]
        try:
            action()
        except (Error, *AWAY, subprocess.SubprocessError) as error:
            self.book.errors.append(f"{action.__name__}: {type(error).__name__}: {error}")
        self.book.count(action.__name__)
        return action.__name__

    def _rorg(self, *words: str) -> subprocess.CompletedProcess[str]:
        return commands.run([*words], self.rorg.environment(), cwd=self.rorg.folder, timeout=120.0)

    # -- people ------------------------------------------------------------------------------------------------

    def edit(self) -> None:
        """Mostly well; what is bad is mended first."""
        self.number += 1
        bad = sorted(n for n, (k, _) in self.book.editions.items() if self.tree.kinds[k] != GOOD)
        mends = bad and self.dice.random() < 0.7
        name = self.dice.choice(bad if mends else [*SERVICES])
        kind = GOOD if mends else self.dice.choices((GOOD, CRASHES, SILENT, REFUSED), (70, 15, 8, 7))[0]
        began = time.time()
        self.tree.save(name, self.number, kind)
        self.book.changed(began)

    def edit_file(self) -> None:
        self.number += 1
        bad = [n for n, (_, k) in self.book.editions.items() if self.tree.kinds[k] != GOOD]
        name = bad[0] if bad else self.dice.choice(MOUNTING)
        began = time.time()
        self.tree.save_file(name, self.number, CRASHES if not bad and self.dice.random() < 0.2 else GOOD)
        self.book.changed(began, name)

    def commit(self) -> None:
        self.tree.commit(f"State {self.number}")

    def revert(self) -> None:
        began = time.time()
        if not self.tree.clean():
            self.tree.git("checkout", "--quiet", "--", ".")
        else:
            with contextlib.suppress(subprocess.CalledProcessError):
                self.tree.git("revert", "--no-edit", "HEAD")
            with contextlib.suppress(subprocess.CalledProcessError):
                self.tree.git("revert", "--abort")
        self.book.changed(began)

    def rollback(self) -> None:
        """It refuses to lose what is not committed."""
        began = time.time()
        if self.dice.random() < 0.7:
            self.commit()
        done = self._rorg("rollback", "--yes", "--timeout", "10s", "--manifests", str(self.tree.root))
        self.book.count(f"rollback exit {done.returncode}")
        self.book.changed(began)

    def hold(self) -> None:
        name, seconds = self.dice.choice([*SERVICES]), self.dice.choice((5.0, 30.0))
        with self.book.lock:
            self.book.unknown.add(f"hold {name}")
        try:
            self.client.hold(name, seconds, "soak", force=True)
        except (Refused, Invalid):
            pass
        else:
            self.book.holds[name] = time.time() + seconds
        self.book.unknown.discard(f"hold {name}")

    def end_hold(self) -> None:
        if self.book.holds:
            name = self.dice.choice(sorted(self.book.holds))
            self.book.unknown.add(f"hold {name}")
            with contextlib.suppress(NotFound, Refused, Invalid):
                self.client.unhold(name)
            self.book.holds.pop(name)
            self.book.unknown.discard(f"hold {name}")

    def retry(self) -> None:
        self._rorg("retry", self.dice.choice([*SERVICES]), "--yes")

    def restart(self) -> None:
        with contextlib.suppress(Refused, Invalid, NotReady):
            self.client.restart(self.dice.choice([*SERVICES]), force=True)

    # -- behind its back ---------------------------------------------------------------------------------------

    def by_hand(self) -> None:
        verb = self.dice.choice(HAND)
        states = {"stop": "running", "kill": "running", "pause": "running", "restart": "running", "unpause": "paused"}
        listed = self.api.containers(all=True, filters={"label": LABEL_SERVICE})
        fits = [c for c in listed if c["State"] == states.get(verb, c["State"])]
        fits = [c for c in fits if verb != "start" or c["State"] in ("exited", "created")]
        if not fits:
            return
        chosen = self.dice.choice(sorted(fits, key=lambda c: (c["Labels"][LABEL_SERVICE], c["Created"])))
        began, service = time.time(), chosen["Labels"][LABEL_SERVICE]
        call = {"rm": lambda id: self.api.remove_container(id, force=True)}.get(verb) or getattr(self.api, verb, None)
        try:
            call(chosen["Id"])
        except docker.errors.APIError:
            self.book.count(f"hand {verb} refused")
        finally:
            self.book.hand(Hand(began, time.time(), verb, chosen["Id"], service))

    # -- faults ------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def away(self) -> Iterator[None]:
        """rorg cannot act while the block runs."""
        began = time.time()
        try:
            yield
        finally:
            self.rorg.away.append(Span(began, time.time() + 2.0))

    def pause(self, seconds: float) -> None:
        threading.Event().wait(seconds)

    def end_rorg(self) -> None:
        with self.away():
            self.rorg.stop(kill=self.dice.random() < 0.6)
            self.pause(self.dice.choice((0.0, 0.5, 3.0)))
            self.rorg.start()

    def end_engine(self) -> None:
        with self.away():
            self.witness.engine_ended()
            began = time.time()
            self.dockerd.stop(kill=self.dice.random() < 0.6)
            self.dockerd.options = ("--live-restore",) if self.dice.random() < 0.5 else ()
            self.pause(self.dice.choice((0.0, 1.0)))
            start_engine(self.dockerd)
            # An engine that was killed ends what it finds when it begins.
            self.book.hands.append(Hand(began, time.time(), "unpause", "", ""))

    def freeze(self) -> None:
        """As if the machine were busy."""
        process = self.dice.choice((self.rorg.process, self.dockerd.process))
        with self.away():
            process.send_signal(signal.SIGSTOP)
            try:
                self.pause(self.dice.choice((0.5, 3.0, 6.0)))
            finally:
                process.send_signal(signal.SIGCONT)

    def step_clock(self) -> None:
        self.rorg.offset.write_text(str(self.dice.choice(STEPS)))
