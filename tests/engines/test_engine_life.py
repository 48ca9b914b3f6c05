"""A day of a robot on the engine that RORG_TEST_ENGINE names: requests, updates, and kills of programs, of rorg and of
the engine. Nothing may surprise rorg, and no container may be made that nobody asked for.

RORG_TEST_CYCLES and RORG_TEST_UPDATES make it longer: `make engines` takes 200 and 20."""

from __future__ import annotations

import os
import random
import re
from collections import Counter

import pytest
from common import wait_for
from robots import Daemon, RealRobot, write_tree

from rorg.engines.docker.engine import DockerEngine
from rorg.engines.docker.lacking import capabilities

CYCLES = int(os.environ.get("RORG_TEST_CYCLES") or 20)
UPDATES = int(os.environ.get("RORG_TEST_UPDATES") or 4)
SOON = {"stop_grace_period": "3s"}
PAUSE = {"action": "pause", "linger": 0}
STOP = {"action": "stop", "linger": 0}
SERVICES: dict[str, dict] = {
    "base": {"always_on": True},
    "camera": {"idle": PAUSE},
    "lidar": {"idle": STOP},
    "map": {"idle": PAUSE},
    "localization": {"needs": ["lidar", "map"], "idle": STOP},
    "navigation": {"needs": ["localization"], "idle": PAUSE},
    "arm": {"idle": STOP},
    "gripper": {"needs": ["arm"], "idle": PAUSE},
}
TOUR = (("navigation",), ("camera", "gripper"), ("navigation", "camera"), ("arm",), ("lidar",))


class Day:
    def __init__(self, folder, kind: str, engine) -> None:
        """`engine`: its server; None for plain processes."""
        self.engine, self.robot = engine, RealRobot(folder, kind, engine and engine.host)
        if isinstance(self.robot.engine, DockerEngine):
            self.robot.engine.capabilities = capabilities(self.robot.engine.client)
        self.log, self.turns = folder / "run.log", Counter[str]()
        self.declare()
        self.daemon, self.chance = Daemon(self.robot), random.Random(4)
        self.daemon.start()
        self.client = self.robot.client(patience=60.0)
        self.client.wait("base", timeout=60)

    def declare(self) -> None:
        """Every service says how often it was changed."""
        specs = {}
        for name, spec in SERVICES.items():
            turn = {"environment": {"TURN": str(self.turns[name])}}
            specs[name] = {**spec, "update": {"bake": "300ms"}, "container": {**SOON, **turn}}
        write_tree(self.robot.tree, specs)

    def request(self, *services: str) -> None:
        with self.client.request(*services, wait=60):
            active = self.robot.active()
            assert set(services) <= active, f"ready was said of {services}; {active} run"

    def update(self, name: str) -> None:
        before = {c.id for c in self.robot.containers() if c.service == name}
        self.turns[name] += 1
        self.declare()

        def made() -> bool:
            return any(c.service == name and c.id not in before for c in self.robot.containers())

        wait_for(made, 60, f"a new container of {name}: {self.robot.states()}")
        with self.client.request(name, wait=60):
            assert self.robot.container(name).id not in before
            wait_for(lambda: self.count(name) == 1, 60, f"the change of {name} to be proven")

    def count(self, name: str) -> int:
        return sum(c.service == name for c in self.robot.containers())

    def ends_of_programs(self) -> None:
        for name in ("base", "arm"):
            with self.client.request("arm", wait=60):
                before = self.robot.container(name)
                self.robot.kill(name)
                again = lambda name=name, before=before: (  # noqa: E731
                    (now := self.robot.container(name)).state == "running" and now.incarnation != before.incarnation
                )
                wait_for(again, 60, f"{name} to run again")

    def ends_of_rorg(self) -> None:
        for end in (self.daemon.kill, self.daemon.stop):
            with self.client.request("camera", wait=60):
                run = self.robot.container("camera").incarnation
            end()
            self.daemon.start()
            self.client.wait("base", timeout=60)
            self.request("camera")
            if self.robot.can("pause"):
                assert self.robot.container("camera").incarnation == run, "its program was disturbed"

    def ends_of_the_engine(self) -> None:
        for kill in (True, False) if self.engine else ():
            self.engine.stop(kill=kill)
            self.engine.start()
            wait_for(lambda: "base" in self.robot.active(), 90, f"base to run: {self.robot.states()}")
            wait_for(lambda: not self.wrong(), 60, "the robot to be as asked for")
            self.request("navigation")

    def wrong(self) -> list[str]:
        status = self.robot.status()
        return [] if status.get("plan", {}).get("waitings") == [] else ["waiting"]

    def created(self) -> Counter[str]:
        """By service, how many containers were made."""
        return Counter(re.findall(r"^\S+ \+ create (\S+) \(.*done", self.log.read_text(), re.MULTILINE))

    def close(self) -> None:
        self.daemon.end()
        self.robot.close()


@pytest.fixture(params=["process", pytest.param("docker", marks=pytest.mark.docker)])
def day(request, tmp_path):
    engine = request.getfixturevalue("dockerd") if request.param == "docker" else None
    if engine and not hasattr(engine, "folder"):
        pytest.skip("somebody else's engine is not stopped here")
    found = Day(tmp_path, request.param, engine)
    yield found
    found.close()


@pytest.mark.slow
def test_a_day_passes_without_a_surprise(day):
    for services in TOUR:
        day.request(*services)
    for number in range(CYCLES):
        day.request(*day.chance.sample(sorted(SERVICES), 1 + number % 2))
    for number in range(UPDATES):
        day.update(sorted(SERVICES)[number % len(SERVICES)])
    day.ends_of_programs()
    day.ends_of_rorg()
    day.ends_of_the_engine()
    for services in TOUR:
        day.request(*services)
    log = day.log.read_text()
    assert "bug:" not in log
    assert "internal error" not in log
    assert day.created() == {name: 1 + day.turns[name] for name in SERVICES}, "a container that nobody asked for"
