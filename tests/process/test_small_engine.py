"""An engine that cannot pause, rename, run commands inside, or report events: rorg runs a robot on it nevertheless."""

from __future__ import annotations

import builtins
import signal
import subprocess
import threading
import time
import uuid
from dataclasses import replace
from typing import ClassVar

import pytest
from common import wait_for
from robots import WORK, RealRobot

from rorg.core.observed import Container, from_labels
from rorg.engines.protocol import NONE, Engine, stop_sequence
from rorg.errors import EngineError
from rorg.model.engines import Capabilities
from rorg.model.units import stamp


class SmallEngine(Engine):
    """Plain processes, known only to this object."""

    name, address, local = "small", "", True
    ignored: ClassVar[frozenset[str]] = frozenset()
    """Options that it knows and does not follow."""
    capabilities = Capabilities(
        server=False, isolation=False, images=False, pause=False, rename=False, update=False, exec=False, logs=False,
        events=False, stats=False,
    )  # fmt: skip

    def __init__(self) -> None:
        self.made: dict[str, Container] = {}
        self.commands: dict[str, list[str]] = {}
        self.runs: dict[str, subprocess.Popen] = {}
        self.lock = threading.Lock()

    def create(self, name, spec, labels, before="", defaults=()) -> str:
        with self.lock:
            if any(c.name == name for c in self.made.values()):
                raise EngineError(f"create {name}", "the name is taken", kind="name_taken")
            container = uuid.uuid4().hex * 2
            self.commands[container] = [*spec.get("entrypoint", []), *spec["command"]]
            now = stamp(time.time())
            live = dict.fromkeys(self.ignored, 0)
            marks = from_labels(labels)
            self.made[container] = Container(container, name, state="created", created_at=now, live=live, **marks)
            return container

    def start(self, container: str) -> None:
        self.runs[container] = subprocess.Popen(self.commands[container])
        self.made[container] = replace(self.made[container], started_at=stamp(time.time()))

    def stop(self, container: str, signal: str, grace: float) -> None:
        for name, seconds in stop_sequence(signal, grace):
            self.signal(container, name)
            try:
                self.runs[container].wait(seconds)
                return
            except subprocess.TimeoutExpired:
                continue

    def signal(self, container: str, name: str) -> None:
        self.runs[container].send_signal(signal.Signals[name])

    def remove(self, container: str, volumes: bool = False) -> None:
        self.made.pop(container, None)

    def list(self, known=NONE) -> builtins.list[Container]:
        return [c for name in tuple(self.made) if (c := self.inspect(name))]

    def inspect(self, container: str) -> Container | None:
        found, run = self.made.get(container), self.runs.get(container)
        if found is None or run is None:
            return found
        code = run.poll()
        state = "running" if code is None else "exited"
        return replace(found, state=state, exit_code=code, pid=run.pid if code is None else 0)


@pytest.fixture
def robot(tmp_path):
    found = RealRobot(tmp_path, "process", None)
    found.engine = SmallEngine()
    yield found
    found.close()


PAUSING = {"idle": {"action": "pause"}}
TOUR = {"camera": PAUSING, "navigation": {**PAUSING, "needs": ["camera"]}, "arm": {**PAUSING, "conflicts": ["camera"]}}


def names(robot: RealRobot) -> set[str]:
    return {container.name for container in robot.containers()}


def test_a_tour_of_requests_stops_instead_of_pausing(robot):
    robot.declare(TOUR)
    for services, running in (
        (["navigation"], {"camera", "navigation"}),
        (["arm"], {"arm"}),
        (["camera"], {"camera"}),
        ([], set()),
        (["navigation"], {"camera", "navigation"}),
    ):
        robot.change(lambda asked: asked.without({("developer", "test")}))
        if services:
            robot.request(*services)
        robot.wait(lambda running=running: robot.active() == running)
    assert set(robot.states().values()) <= {"running", "exited", "created"}
    assert any("stop instead of pause: the engine cannot pause" in line for line in robot.log())
    assert not [line for line in robot.log() if "failed" in line]


@pytest.mark.slow
def test_a_changed_service_is_replaced_without_another_name(robot):
    robot.declare({"camera": {"always_on": True}})
    robot.wait(lambda: robot.active() == {"camera"})
    for turn in ("1", "2"):
        before = robot.container("camera").id
        robot.declare({"camera": {"always_on": True, "container": {"environment": {"TURN": turn}}}})
        robot.wait(lambda before=before: robot.active() == {"camera"} and robot.container("camera").id != before)
        robot.settle()
        robot.wait(lambda: len(robot.containers()) == 1)
        assert all(name == "camera" or name.startswith("camera.") for name in names(robot))
    assert names(robot) == {"camera"}, "every second container has the name of the service again"


def test_a_change_that_does_not_come_up_goes_back(robot):
    robot.declare({"camera": {"always_on": True}})
    robot.wait(lambda: robot.active() == {"camera"})
    before = robot.container("camera").id
    robot.declare({"camera": {"always_on": True, "command": ["false"]}})
    robot.wait(lambda: any("update-failed" in line or "back to the previous container" in line for line in robot.log()))
    robot.wait(lambda: robot.active() == {"camera"} and robot.container("camera").id == before)


@pytest.mark.slow
def test_a_limit_that_it_ignores_makes_no_containers_without_end(robot):
    """As rootless Podman does on control groups of version 1."""
    robot.engine.ignored = frozenset(("pids_limit",))
    limited = {"always_on": True, "container": {"pids_limit": 100}}
    robot.declare({"camera": limited})
    robot.wait(lambda: robot.active() == {"camera"})
    robot.settle()
    before = robot.container("camera").id
    robot.declare({"camera": limited, "map": {}})
    robot.wait(lambda: "map" in robot.states())
    robot.settle()
    assert robot.container("camera").id == before
    robot.declare({"camera": {"always_on": True, "container": {"pids_limit": 200}}, "map": {}})
    robot.wait(lambda: robot.active() == {"camera"} and robot.container("camera").id != before)
    robot.settle()
    assert len([line for line in robot.log() if line.startswith("+ create camera")]) == 2


def test_an_end_is_seen_without_events(robot):
    robot.declare({"camera": {"always_on": True}})
    robot.wait(lambda: robot.active() == {"camera"})
    run = robot.container("camera").incarnation
    robot.engine.signal(robot.container("camera").id, "SIGKILL")
    robot.wait(lambda: robot.active() == {"camera"} and robot.container("camera").incarnation != run)


def test_what_it_cannot_do_is_refused_with_the_reason(robot):
    engine = robot.engine
    container = engine.create("camera", {"command": WORK}, {})
    for call in (
        lambda: engine.pause(container),
        lambda: engine.rename(container, "other"),
        lambda: engine.exec(container, ["true"], 1.0),
    ):
        with pytest.raises(EngineError, match="the small engine cannot do that") as caught:
            call()
        assert caught.value.kind == "unsupported"
    wait_for(lambda: engine.usage([]) == {})
