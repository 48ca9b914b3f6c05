"""rorg simulate: its figures, series and pictures, and what it says of files that are wrong."""

from __future__ import annotations

import csv
import json

import commands
import pytest
from robots import write_tree

MANIFESTS = {
    "behaviour": {"resources": {"cpu": 0.1, "memory": "10Mi"}},
    "camera": {"resources": {"cpu": 0.5, "memory": "100Mi"}, "idle": {"action": "pause"}},
    "lamp": {"resources": {"cpu": 0.25, "memory": "50Mi"}, "needs": ["camera"]},
}
TRACE = """apiVersion: rorg/v1
kind: Trace
metadata: {name: visit}
spec:
  duration: 60s
  behaviour: behaviour
  states:
    look: [camera]
    rest: []
  events:
    - {at: 0s, request: work, services: [behaviour]}
    - {at: 10s, state: look}
    - {at: 30s, state: rest}
"""
WORKLOAD = """apiVersion: rorg/v1
kind: Workload
metadata: {name: spread}
spec:
  services:
    camera: {cpu: {active: {mean: 0.5, deviation: 0.1}}, start: [1s, 2s]}
"""


@pytest.fixture
def robot(tmp_path):
    write_tree(tmp_path / "manifests", MANIFESTS)
    (tmp_path / "visit.yaml").write_text(TRACE)
    (tmp_path / "spread.yaml").write_text(WORKLOAD)
    return tmp_path


def simulate(robot, *words: str, code: int = 0):
    done = commands.run(["simulate", *words], cwd=robot)
    assert done.returncode == code, done.stderr
    return done


@pytest.mark.slow
def test_both_runs_in_figures(robot):
    found = json.loads(simulate(robot, "visit.yaml", "-o", "json").stdout)
    base, rorg = found["runs"]
    assert (base["run"], rorg["run"]) == ("all-on", "rorg")
    assert base["cpu"] == pytest.approx(0.85, abs=0.01)
    assert rorg["cpu"] == pytest.approx(0.1 + 0.5 / 3, abs=0.01)
    assert rorg["reduction"]["cpu"] == pytest.approx(1 - rorg["cpu"] / base["cpu"])
    assert rorg["responses"]["look"]["count"] == 1
    assert rorg["violated"] == []
    table = simulate(robot, "visit.yaml").stdout.splitlines()
    assert [line.split()[0] for line in table] == ["RUN", "all-on", "rorg"]


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes(robot):
    def told(seed: str) -> str:
        line = ["visit.yaml", "--workload", "spread.yaml", "--seed", seed, "-o", "json", "--csv", "series.csv"]
        return simulate(robot, *line).stdout.replace(f'"seed": {seed}', "") + (robot / "series.csv").read_text()

    assert told("3") == told("3")
    assert told("3") != told("4")


@pytest.mark.slow
def test_series_and_picture(robot):
    simulate(robot, "visit.yaml", "--every", "2s", "--csv", "series.csv", "--plot", "visit.svg")
    with (robot / "series.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 30
    row = next(r for r in rows if r["run"] == "rorg" and float(r["at"]) == 20.0)
    assert (row["state"], float(row["cpu"]), row["active"]) == ("look", pytest.approx(0.6), "2")
    picture = (robot / "visit.svg").read_text()
    assert all(word in picture for word in ("all-on", "rorg", "look", "synthetic weights"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        ("visit.yaml", "look: [camera]", "look: [camra]", "visit.yaml:8:12: error: no service or group 'camra'"),
        ("visit.yaml", "state: look", "state: lok", "visit.yaml:12:24: error: unknown state 'lok'"),
        ("visit.yaml", "at: 30s", "at: 3s", "visit.yaml:13:12: error: it comes after an entry of 10 s"),
        ("visit.yaml", "at: 30s", "at: 3 bells", "visit.yaml:13:12: "),
        ("visit.yaml", "kind: Trace", "kind: Race", "visit.yaml:2:7: error: the kind must be Trace"),
        ("spread.yaml", "mean: 0.5", "mean: half", "spread.yaml:6:35: "),
        ("spread.yaml", "start: [1s, 2s]", "begin: 1s", "spread.yaml:6:"),
    ],
)
def test_what_is_wrong_is_told_with_its_place(robot, file, old, new, said):
    path = robot / file
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    assert said in simulate(robot, "visit.yaml", "--workload", "spread.yaml", code=2).stderr


def test_a_trace_is_no_part_of_a_tree(robot):
    (robot / "manifests/visit.yaml").write_text(TRACE)
    told = commands.run(["validate", "manifests"], cwd=robot)
    assert told.returncode == 2
    assert "rorg simulate" in told.stderr
