"""`rorg simulate --compare` and `--sweep`: variants of a robot, side by side."""

from __future__ import annotations

import csv
import json
from io import StringIO

import commands
import pytest
from robots import write_tree

from rorg.manifest.traces import trace_text
from rorg.model.trace import Trace, TraceEvent

SERVICES = {
    "camera": {"resources": {"cpu": 0.5, "memory": "100Mi"}},
    "base": {"always_on": True, "resources": {"cpu": 0.1, "memory": "10Mi"}},
}
LOOKS = tuple(
    TraceEvent(20.0 * i + after, "developer", "look", services)
    for i in range(5)
    for after, services in ((1.0, ("camera",)), (11.0, ()))
)


@pytest.fixture
def folder(tmp_path):
    write_tree(tmp_path / "manifests", SERVICES)
    (tmp_path / "looks.yaml").write_text(trace_text(Trace("looks", 100.0, LOOKS)))
    return tmp_path


def simulate(folder, *words: str, code: int = 0):
    line = ["simulate", str(folder / "looks.yaml"), str(folder / "manifests"), *words]
    return commands.rorg(*line, code=code, RORG_STATE_DIR=str(folder / "state"))


@pytest.mark.slow
def test_variants_are_compared_with_all_on_and_with_the_tree_as_it_is(folder):
    found = json.loads(simulate(folder, "--compare", "linger=1m", "--compare", "soft=idle=pause", "-o", "json").stdout)
    by_name = {one["run"]: one for one in found}
    assert list(by_name) == ["all-on", "as-declared", "linger=1m", "soft"]
    assert by_name["soft"]["settings"] == {"idle": "pause"}
    cpu = {name: one["cpu"] for name, one in by_name.items()}
    assert cpu["as-declared"] == pytest.approx(cpu["soft"], abs=0.02)
    assert cpu["as-declared"] < 0.4 < 0.55 < cpu["linger=1m"] <= cpu["all-on"] < 0.6
    assert {one["requests"] for one in found} == {5}
    median = {name: one["response_median"] for name, one in by_name.items()}
    assert median["linger=1m"] == 0 < median["soft"] < median["as-declared"]
    assert by_name["as-declared"]["calls"] == 2 + 1 + 5 + 5, "create both, start base, start and stop camera"
    assert simulate(folder, "--compare", "linger=1m", "-o", "name").stdout.split() == [
        "all-on",
        "as-declared",
        "linger=1m",
    ]


@pytest.mark.slow
def test_a_sweep_is_a_table_a_csv_and_a_picture(folder):
    swept = simulate(
        folder, *("--sweep", "linger=0s,1m", "--sweep", "idle=pause,stop"),
        *("--csv", str(folder / "sweep.csv"), "--plot", str(folder / "sweep.svg")),
    )  # fmt: skip
    rows = list(csv.DictReader(StringIO((folder / "sweep.csv").read_text())))
    assert [(row["linger"], row["idle"]) for row in rows[1:]] == [
        *(("0s", "pause"), ("0s", "stop"), ("1m", "pause"), ("1m", "stop"))
    ]
    assert rows[0]["run"] == "as-declared"
    assert [line.split()[0] for line in swept.stdout.splitlines()[1:]] == [row["run"] for row in rows]
    assert float(rows[4]["cpu"]) > float(rows[2]["cpu"])
    picture = (folder / "sweep.svg").read_text()
    assert "idle=pause" in picture
    simulate(folder, *("--sweep", "linger=0s,1m", "--sweep", "idle=pause,stop", "--plot", str(folder / "again.svg")))
    assert (folder / "again.svg").read_text() == picture, "the same figures give the same picture"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--compare", "linger=1m", "--sweep", "linger=1m"], "one of them"),
        (["--compare", "other={folder}/other"], "names camera"),
        (["--compare", "linger=soon"], "not a duration"),
        (["--sweep", "linger=1m", "--csv", "{folder}/nosuch/x.csv"], "nosuch"),
        (["--sweep", "linger=1m", "--plot", "{folder}/x.gif"], ".gif"),
    ],
)
def test_what_makes_no_sense_is_refused(folder, words, why):
    write_tree(folder / "other", {"arm": {}})
    said = simulate(folder, *(word.format(folder=folder) for word in words), code=2).stderr
    assert why in said
    assert "; try" in said
