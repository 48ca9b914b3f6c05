"""Updates and rollbacks on a real engine, with rorg killed and the engine restarted at random moments of them."""

from __future__ import annotations

import contextlib
import json
import os
import threading
import time
from pathlib import Path

import commands
import docker
import pytest
from common import BASE_IMAGE, wait_for
from fuzzing import ONLY, Case, count
from histories import integrity
from robots import WORK, write_tree

from rorg.core.observed import LABEL_OWNER, LABEL_SERVICE, LABEL_SPEC
from rorg.history.database import reading
from rorg.history.revisions import Revisions
from rorg.store.state_dir import StateDir

ROUNDS = 3
"""Without FUZZ; see fuzzing.FULL for all."""
LONGEST = 20.0
"""Seconds for which nothing may run of a service that is wanted, on a machine that does much else."""
LOOKS = 0.02
"""Seconds between two looks at the engine."""
SERVICES = ("arm", "base")
GOOD, ENDS, LATE = WORK, ["false"], ["sleep", "600"]
"""`ends` ends at once, and `late` never gets ready."""


class Watch(threading.Thread):
    """Looks at what runs, all the time, and keeps what must not be: two containers of one service that run, or for too
    long none. While the engine does not answer nothing is known."""

    def __init__(self, host: str, owner: str) -> None:
        super().__init__(daemon=True)
        self.api, self.owner = docker.APIClient(host, version="auto"), owner
        self.over, self.wrong = threading.Event(), list[str]()
        self.longest = 0.0
        self._missing: dict[str, float] = {}

    def run(self) -> None:
        while not self.over.wait(LOOKS):
            try:
                found = self.running()
            except Exception:  # whatever its client says of an engine that is not there
                self._missing.clear()
                continue
            for name in SERVICES:
                if len(found.get(name, [])) > 1:
                    self.wrong.append(f"two of {name} run: {found[name]}")
                since = self._missing.setdefault(name, time.monotonic())
                self.longest = max(self.longest, time.monotonic() - since)
                if found.get(name):
                    self._missing.pop(name)

    def running(self) -> dict[str, list[str]]:
        """Service -> digests of what runs of it was made from. Each is asked for again: a list is no one moment."""
        found: dict[str, list[str]] = {}
        for row in self.api.containers(filters={"label": f"{LABEL_OWNER}={self.owner}"}):
            with contextlib.suppress(docker.errors.NotFound):  # it has gone since the list
                if not self.api.inspect_container(row["Id"])["State"]["Running"]:
                    continue
                found.setdefault(row["Labels"][LABEL_SERVICE], []).append(row["Labels"][LABEL_SPEC])
        return found


class Robot:
    def __init__(self, folder: Path, host: str) -> None:
        self.folder, self.tree, self.state = folder, folder / "tree", StateDir(folder / "state").prepare()
        self.env = {**os.environ, "DOCKER_HOST": host}
        self.process: commands.Forked | None = None
        self.doubtful: set[int] = set()
        """Editions that were on trial when the engine ended what runs: that may count as a change that failed."""

    def declare(self, edition: int, command: list[str]) -> None:
        ready = {"exec": ["sh", "-c", "test $EDITION != late"], "timeout": "1s", "interval": "100ms"}
        word = "late" if command is LATE else str(edition)
        spec = {
            "image": BASE_IMAGE,
            "always_on": True,
            "command": command,
            "ready": ready,
            "update": {"bake": "300ms"},
            "container": {"environment": {"EDITION": word, "NUMBER": str(edition)}, "init": True},
        }
        write_tree(self.tree, {"arm": spec, "base": {**spec, "needs": ["arm"]}})

    def start(self) -> None:
        words = ["run", self.tree, "--state-dir", self.state.path, "--engine", "docker"]
        with (self.folder / "rorg.log").open("ab") as log:
            self.process = commands.Forked(words, self.env, stdout=log, stderr=log)

    def kill(self) -> None:
        os.kill(self.process.pid, 9)
        with contextlib.suppress(ValueError):
            self.process.wait(60)


@pytest.mark.docker
def test_kills_at_any_moment_of_an_update(dockerd, tmp_path):
    """Every round declares another edition (good, one that ends, one that is never ready, or one of before), kills rorg
    at some moment of what follows, at times restarts the engine too, and looks at what comes of it."""
    robot = Robot(tmp_path, dockerd.host)
    robot.declare(0, GOOD)
    robot.start()
    wait_for(lambda: robot.state.path.joinpath("instance").exists(), 60)
    watch = Watch(dockerd.host, robot.state.instance(lambda: "none"))
    wait_for(lambda: all(len(watch.running().get(name, [])) == 1 for name in SERVICES), 60)
    watch.start()
    try:
        for number in [int(ONLY)] if ONLY else range(count("kills", ROUNDS)):
            one_round(robot, watch, dockerd, Case.of("kills", number))
    finally:
        watch.over.set()
        watch.join(60)
        robot.kill()
        for row in watch.api.containers(all=True, filters={"label": f"{LABEL_OWNER}={watch.owner}"}):
            watch.api.remove_container(row["Id"], force=True)
    assert watch.wrong == []
    assert watch.longest < LONGEST
    assert integrity(robot.state.journal) == "ok"


def one_round(robot: Robot, watch: Watch, dockerd, case: Case) -> None:
    chance, good = case.chance, case.number % 3 != 1
    edition = chance.randrange(3) if case.number % 3 == 2 else case.number + 10
    robot.declare(edition, GOOD if good else chance.choice((ENDS, LATE)))
    time.sleep(chance.uniform(0, 2.0))  # the moment is the case
    robot.kill()
    if case.number % 4 == 2 and hasattr(dockerd, "stop"):
        dockerd.stop(kill=chance.random() < 0.5)
        dockerd.start()
        robot.doubtful.add(edition)
    robot.start()
    sure = good and edition not in robot.doubtful

    def settled() -> bool:
        found = watch.running()
        known = [len(found.get(n, [])) == 1 and found[n][0] in wanted(robot, n, sure) for n in SERVICES]
        return all(known) and at_rest(robot)

    wait_for(settled, 90, f"round {case.number} is over")


def at_rest(robot: Robot) -> bool:
    """Nothing is to be done, by what the running rorg says."""
    words = ["diff", "-o", "json", "--state-dir", str(robot.state.path)]
    done = commands.run(words, robot.env)
    return done.returncode in (0, 1) and not json.loads(done.stdout)["actions"]


def wanted(robot: Robot, service: str, good: bool) -> set[str]:
    """Digests that a container of it may have been made from, by what the history says: of the last state of the
    manifests where that is good, else of any: it may have come up, or be back at what was before."""
    revisions = made(robot)
    return {r.get(service, "") for r in (revisions[-1:] if good else revisions)}


def made(robot: Robot) -> list[dict[str, str]]:
    """Of every revision, the first one first: what its services were made from."""
    with reading(robot.state.journal) as database:
        revisions = Revisions(database)
        found = [revisions.get(r.number) for r in reversed(revisions.list(1000))]
    return [{name: made.digest for name, made in r.services.items()} for r in found if r and r.standing != "refused"]
