"""`rorg fit`: what services used while they ran, and manifests that say so; how long they take to start."""

from __future__ import annotations

import itertools
import json
import sys

import pytest
import yaml
from commands import run
from common import ROOT, free_port, wait_for
from robots import RealRobot

from rorg.core.observed import Container
from rorg.daemon.usage_recorder import UsageRecorder
from rorg.engines.protocol import Usage
from rorg.history.database import Database
from rorg.history.durations import learned_workload
from rorg.history.retention import Retention, trim
from rorg.history.usage import MACHINE, Measured, UsageTable
from rorg.manifest.fitting import fit
from rorg.manifest.workloads import read_workload, workload_text
from rorg.model.workload import Distribution

MIB = 1 << 20
HEAD = "apiVersion: rorg/v1\nkind: Service\nmetadata:\n  name: camera\n"
USED = {"seconds": 3600.0, "cpu": 0.3, "memory": 80 * MIB, "peak_memory": 100 * MIB}


def fitted(spec: str, margin: float = 0.1, **measured) -> str:
    return fit("camera", HEAD + spec, {**USED, **measured}, margin).text.removeprefix(HEAD)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (
            "spec:\n  image: a  # the usual\n  resources: {cpu: 0.6, memory: 180Mi}   # synthetic\n  restart: never\n",
            "spec:\n  image: a  # the usual\n  resources: {cpu: 0.33, memory: 110Mi}   # synthetic\n  restart: never\n",
        ),
        (
            "spec:\n  resources:\n    cpu: 1    # guessed\n    memory: '1Gi'\n  image: a\n",
            "spec:\n  resources:\n    cpu: 0.33    # guessed\n    memory: 110Mi\n  image: a\n",
        ),
        (
            "spec:\n  resources:\n    # more at night\n    cpu: 0.6\n  image: a\n",
            "spec:\n  resources:\n    # more at night\n    memory: 110Mi\n    cpu: 0.33\n  image: a\n",
        ),
        (
            "spec:\n  resources: {memory: 110Mi}\n  image: a\n",
            "spec:\n  resources: {cpu: 0.33, memory: 110Mi}\n  image: a\n",
        ),
        (
            "spec:\n  image: a\n# the end\n",
            "spec:\n  image: a\n  resources: {cpu: 0.33, memory: 110Mi}\n# the end\n",
        ),
        ("spec:\n  image: a", "spec:\n  image: a\n  resources: {cpu: 0.33, memory: 110Mi}"),
    ],
)
def test_only_these_values_change(before, after):
    assert fitted(before) == after
    assert fitted(after) == after, "what fits stays"


def test_what_is_near_stays():
    near = "spec:\n  resources: {cpu: 0.35, memory: 102Mi}\n"
    assert fitted(near) == near
    assert fitted(near, margin=0.0) == "spec:\n  resources: {cpu: 0.3, memory: 100Mi}\n"


@pytest.mark.parametrize(
    ("spec", "measured", "why"),
    [
        ("spec:\n  image: a\n", {"seconds": 59.0}, "it was measured for only 59 s"),
        ("spec: {image: a}\n", {}, "write it there"),
        ("spec:\n  resources: *none\n", {}, "cannot be read"),
    ],
)
def test_why_nothing_is_proposed(spec, measured, why):
    found = fit("camera", HEAD + spec, {**USED, **measured}, 0.1)
    assert why in found.why_not
    assert found.text == HEAD + spec
    assert not found.after


class Programs:
    """What runs, and what it has used, as an engine says it."""

    def __init__(self, database: Database) -> None:
        self.now, self.used, self.there, self.asked = 0.0, 0.0, list[tuple[Container, float | None]](), 0
        self.table = UsageTable(database)
        self.recorder = UsageRecorder(self.table, lambda: self.there, self.usage, lambda: self.now, self.wall)

    def wall(self) -> str:
        return f"2026-01-01T{int(self.now // 3600):02}:{int(self.now % 3600 // 60):02}:00Z"

    def usage(self, containers) -> dict[str, Usage]:
        self.asked += 1
        return {c.id: Usage(self.used, 50 * MIB) for c in containers}

    def run(self, started: float, since: float) -> None:
        one = Container("c" * 64, "camera", "camera", "running", started_at=f"2026-01-01T00:{started:02.0f}:30Z")
        self.there = [(one, since)]


@pytest.fixture
def programs(tmp_path):
    counter = itertools.count()
    database = Database(tmp_path / "journal.db", lambda: f"2026-01-01T00:00:{next(counter):02}Z")
    yield Programs(database)
    database.close()


def test_what_is_paused_does_not_count(programs):
    programs.run(1, 60.0)
    programs.now, programs.used = 120.0, 30.0
    programs.recorder.look()
    programs.now, programs.used = 140.0, 40.0
    programs.recorder.look("camera")  # before it is paused
    programs.there = [(programs.there[0][0], None)]
    programs.now = 180.0
    programs.recorder.look()  # while it is paused
    programs.there = [(programs.there[0][0], 1000.0)]
    programs.now, programs.used = 1020.0, 50.0
    programs.recorder.look()
    (found,) = programs.table.since("2026-01-01T00:00:00Z")
    assert (found["seconds"], found["cpu"], found["runs"]) == (100.0, 0.5, 1)
    assert found["peak_memory"] == 50 * MIB


def test_of_a_run_from_before_only_what_follows_counts(programs):
    programs.recorder.began = "2026-01-01T00:02:00Z"
    programs.run(1, 60.0)
    programs.now, programs.used = 120.0, 5000.0
    programs.recorder.look()
    programs.now, programs.used = 180.0, 5006.0
    programs.recorder.look()
    (found,) = programs.table.since("2026-01-01T00:00:00Z")
    assert (found["seconds"], found["cpu"]) == (60.0, 0.1)


def test_nothing_is_asked_while_nothing_runs(programs):
    programs.recorder.look()
    assert programs.asked == 0


def test_what_is_kept_is_bounded(programs):
    for hour in range(10):
        programs.table.note(f"2026-01-01T0{hour}:00:00Z", [Measured("camera", f"r{hour}", 60.0, 6.0, MIB)])
    trim(programs.table.database, Retention(usage=4), "2025-01-01T00:00:00Z", lambda: None)
    assert programs.table.since("2025")[0]["runs"] == 4
    trim(programs.table.database, Retention(), "2026-01-01T08:30:00Z", lambda: None)
    assert programs.table.since("2025")[0]["runs"] == 1


def test_the_machine_is_measured_also_while_nothing_runs(programs):
    for now, cpu in ((60.0, 100.0), (120.0, 130.0)):
        programs.now = now
        programs.recorder.machine = lambda cpu=cpu: {"cpu_seconds": cpu, "memory": 3 * MIB}
        programs.recorder.look()
    (slot,) = programs.table.slots("2026-01-01T00:00", "2026-01-02")
    assert slot == (slot.at, 60.0, MACHINE, 0.5, 3 * MIB)
    assert slot.at == "2026-01-01T00:02"
    assert programs.table.since("2025") == [], "it is no service"


def test_minutes_are_added_up_after_two_hours(programs):
    for minute in range(240):
        at = f"2026-01-01T{minute // 60:02}:{minute % 60:02}:30Z"
        programs.table.note(at, [Measured("camera", "r", 30.0, 15.0, MIB), Measured(MACHINE, "", 60.0, 60.0, 4 * MIB)])
    before = programs.table.since("2025")
    trim(programs.table.database, Retention(), "2025-01-01T00:00:00Z", lambda: None)
    assert programs.table.since("2025") == before, "no second is lost"
    slots = [slot for slot in programs.table.slots("2025", "2027") if slot.service == "camera"]
    assert [slot.seconds for slot in slots] == [600.0] * 11 + [60.0] * 130, "from 1:50 on each minute is kept"
    assert {(slot.cores, slot.memory) for slot in slots} == {(0.25, MIB / 2)}


BURN = """
import time
keep = bytearray(40 << 20)
while True:
    end = time.process_time() + 0.02
    while time.process_time() < end:
        pass
    time.sleep(0.06)
"""


@pytest.mark.slow
def test_a_real_robot_measures_and_writes(request, tmp_path):
    """The process engine; the minute goes by on the recorder's clock."""
    robot = RealRobot(tmp_path, "process", None, with_server=True)
    request.addfinalizer(robot.close)
    robot.declare({"busy": {"command": ["python3", "-S", "-c", BURN], "resources": {"cpu": 2, "memory": "1Gi"}}})
    robot.request("busy")
    robot.wait(lambda: robot.active() == {"busy"})
    recorder = next(t for t in robot.loop.threads if isinstance(t, UsageRecorder))
    robot.wait(lambda: recorder.alive() and robot.loop.running.use()["busy"][0] > 0.5)
    used, since = robot.loop.running.use()["busy"][0], recorder.alive()[0][1]
    recorder.clock = lambda: since + 100.0
    robot.release()
    robot.wait(lambda: not robot.active())
    path = robot.tree / "services/busy.yaml"
    line = ["fit", "busy", "--state-dir", robot.state.path, "--manifests", robot.tree]
    shown = run(line)
    assert "-  resources:" not in shown.stdout
    cpu = float(next(text for text in shown.stdout.splitlines() if text.startswith("+    cpu:")).partition(":")[2])
    assert used / 100 <= cpu <= 20 * used / 100
    assert run([*line, "--write", "-o", "name"]).returncode == 0
    written = yaml.safe_load(path.read_text())["spec"]["resources"]
    assert written["cpu"] == cpu
    assert 40 <= int(written["memory"].removesuffix("Mi")) < 200
    wait_for(lambda: robot.loop.tree.desired.catalog.services["busy"].cpu == cpu)
    robot.stop()
    assert "it is as declared" in run([*line[:1], *line[2:]]).stderr


def entry(kind: str, second: float, service: str = "arm", **more) -> dict:
    return {"kind": kind, "at": f"2026-01-01T00:00:{second:09.6f}Z", "service": service, **more}


def done(verb: str, second: float, seconds: float, service: str = "arm") -> dict:
    return entry("done", second, service, verb=verb, seconds=seconds)


def state(word: str, second: float) -> dict:
    return entry("state", second, state=word)


def test_durations_follow_from_the_journal(tmp_path):
    journal = [
        *(done("create", 0, 0.02), done("start", 1, 0.1), state("running", 1.1), state("ready", 3.5)),
        *(done("pause", 10, 0.01), state("paused", 10.1), done("resume", 12, 0.01), state("ready", 12.25)),
        *(done("stop", 20, 1.5), state("exited", 20.1), done("stop", 20.5, 0.5, "eyes")),
        *(done("start", 21, 0.2), state("ready", 24)),
        # This run never becomes ready.
        *(done("start", 30, 0.2), state("exited", 31), state("ready", 50)),
    ]
    found = learned_workload("measured", journal)
    assert found.services["arm"].start == Distribution((2.5, 3.0))
    assert found.services["arm"].resume == Distribution((0.25,))
    assert found.services["arm"].stop == Distribution((1.0,)), "besides the engine's part"
    assert found.calls["start"] == Distribution((0.1, 0.2, 0.2))
    assert found.calls["stop"] == Distribution((0.5,))
    file = tmp_path / "workload.yaml"
    file.write_text(workload_text(found))
    assert read_workload(file) == found


def test_a_service_that_is_noted_as_ready_before_its_start_is_has_a_start():
    """The loop and the worker write the journal at the same time."""
    journal = [
        *(state("ready", 1.02), done("start", 1.03, 0.1), state("exited", 5)),
        *(state("ready", 6), done("start", 8, 0.1), state("ready", 9)),
    ]
    assert learned_workload("measured", journal).services["arm"].start == Distribution((0.0, 1.0))


def test_the_newest_durations_are_kept():
    journal = [e for n in range(30) for e in (done("start", n, n), state("ready", n + 0.5 + n / 100))]
    assert [round(v, 2) for v in learned_workload("measured", journal).services["arm"].start.values] == [
        round(0.5 + n / 100, 2) for n in range(10, 30)
    ]


def stand_in(port: int) -> dict:
    """A service that takes a second to start."""
    return {
        "command": [sys.executable, "-S", str(ROOT / "images/standin/standin")],
        "container": {"environment": {"STANDIN_START": "1", "STANDIN_READY": f"tcp:{port}"}},
        "ready": {"tcp": port},
        "idle": {"action": "stop", "linger": "0s"},
    }


@pytest.mark.slow
def test_a_simulation_of_a_recorded_day_waits_as_long_as_the_day_did(request, tmp_path):
    robot = RealRobot(tmp_path, "process", None, with_server=True)
    request.addfinalizer(robot.close)
    robot.declare({"slow": stand_in(free_port()), "later": stand_in(free_port())})
    for _ in range(2):
        for name in ("slow", "later"):  # so that the first request lasts longer than its wait
            robot.request(name, id=name)
            robot.wait(lambda name=name: name in robot.active())
            robot.wait(lambda name=name: robot.loop.decision.memory.of(name).ready)
        for name in ("slow", "later"):
            robot.release(id=name)
        robot.wait(lambda: not robot.active())
        robot.settle()
    at, workload, trace = ("--state-dir", robot.state.path), tmp_path / "workload.yaml", tmp_path / "day.yaml"
    shown = run(["fit", "--workload", workload, *at, "--manifests", robot.tree])
    assert "n=2" in shown.stdout, shown.stderr
    assert run(["trace", "record", *at, "--since", "1h", "--file", trace]).returncode == 0

    def simulated(*words) -> tuple[float, str]:
        ended = run(["simulate", trace, robot.tree, "-o", "json", *words])
        waits = json.loads(ended.stdout)["runs"][1]["responses"]["slow"]
        assert (waits["count"], waits["never"]) == (2, 0)
        return waits["median"], ended.stderr

    waited, told = simulated()
    assert waited < 0.5
    assert told == (
        "2 services (later, slow): no start times are known, so requests wait longer than this says; "
        "try `rorg fit --workload FILE`, then `rorg simulate --workload FILE`\n"
    )
    starts = read_workload(workload).services["slow"].start.values
    assert min(starts) >= 1.0
    waited, told = simulated("--workload", workload)
    assert min(starts) <= waited <= max(starts) + 0.5
    assert told == ""
    robot.stop()
    again = tmp_path / "again.yaml"
    assert run(["fit", "--workload", again, *at, "--manifests", robot.tree, "-o", "json"]).returncode == 0
    assert again.read_text() == workload.read_text(), "without a running rorg, too"
