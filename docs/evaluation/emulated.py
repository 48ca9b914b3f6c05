"""Turns emulation.json into tables and a plot for docs/evaluation.md. `rorg emulate --save` writes that file in an
hour; nothing here measures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from statistics import mean

from rorg.manifest.traces import read_trace
from rorg.tools.sim.plots import draw
from rorg.tools.sim.results import RunResult, Sample

HERE = Path(__file__).parent
FILE = HERE / "emulation.json"
MEASURED = json.loads(FILE.read_text(encoding="utf-8"))
GB = 1e9


def reduction_row() -> str:
    """The row of our emulation, for the table with the paper's figures."""
    cells = (f"-{100 * one['mean']:.1f} %" for one in _reductions())
    return f"| ours: emulation of {MEASURED['trace']}.yaml | {' | '.join(cells)} |"


def headline_rows() -> list[str]:
    """What was measured, for the table at the top of the page."""
    base, rorg = (MEASURED["runs"][first::2] for first in (0, 1))
    use = (
        ("CPU", "cpu", "cores", 1, "; unused programs take all of their CPU"),
        ("memory", "memory", "GB", GB, ""),
    )
    rows = []
    for name, what, unit, size, more in use:
        both = (f"{mean(run['scaled_back'][what] for run in runs) / size:.2f} {unit}" for runs in (base, rorg))
        saved = f"(-{100 * MEASURED['reductions'][what]['mean']:.0f} %)"
        rows.append(f"| {name}, emulated hour | {' | '.join(both)} {saved} | measured on Docker, synthetic{more} |")
    return rows


def _reductions() -> list[Mapping[str, float]]:
    return [MEASURED["reductions"][what] for what in ("cpu", "memory")]


def reductions_table() -> str:
    """Reductions over all pairs."""
    lines = ["| saved, by pair | CPU | memory |", "|---|---|---|"]
    for name, key in (("mean", "mean"), ("least", "least"), ("most", "most"), ("standard deviation", "deviation")):
        lines.append(f"| {name} | " + " | ".join(f"{100 * one[key]:.1f} %" for one in _reductions()) + " |")
    simulated = (f"{100 * _simulated(what):.1f} %" for what in ("cpu", "memory"))
    lines.append(f"| simulated, mean | {' | '.join(simulated)} |")
    return "\n".join(lines)


def _simulated(what: str) -> float:
    """The mean reduction when the same pairs are simulated."""
    runs = [run["simulated"][what] for run in MEASURED["runs"]]
    return mean(1 - rorg / base for base, rorg in zip(runs[::2], runs[1::2], strict=True))


def runs_table() -> str:
    """For each run: use by services, the same scaled back to the whole robot, simulated use, and use by rorg."""
    lines = [
        "| pair | run | cores | scaled back | simulated | memory | simulated | rorg itself | load average |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for number, run in enumerate(MEASURED["runs"]):
        load = " to ".join(f"{one:.0f}" for one in run["load"])
        lines.append(
            f"| {number // 2 + 1} | {run['name']} | {run['cpu']:.3f} | {run['scaled_back']['cpu']:.2f} "
            f"| {run['simulated']['cpu'] / MEASURED['scale']['cpu']:.2f} | {run['memory'] / GB:.2f} GB "
            f"| {run['simulated']['memory'] / GB:.2f} GB "
            f"| {run['rorg']['cpu']:.3f} cores, {run['rorg']['memory'] / 1e6:.0f} MB | {load} |"
        )
    return "\n".join(lines)


def agreement_table() -> str:
    """Agreement of simulation and emulation in the runs with rorg."""
    lines = [
        "| pair | durations | moments | services at moments | whole sets |",
        "|---|---|---|---|---|",
    ]
    for number, run in enumerate(MEASURED["runs"]):
        for how, one in run["agreement"].items() if run["name"] == "rorg" else ():
            lines.append(
                f"| {number // 2 + 1} | {how} | {one['moments']} | {one['services']:.2%} | {one['sets']:.2%} |"
            )
    return "\n".join(lines)


def responses_table() -> str:
    """Response times of the last run with rorg, in real (not compressed) seconds."""
    lines = ["| state | requests | ready | median | longest |", "|---|---|---|---|---|"]
    last = [run for run in MEASURED["runs"] if run["name"] == "rorg"][-1]
    for state, one in last["responses"].items():
        lines.append(
            f"| {state} | {one['requests']} | {one['ready']} | {one['median']:.2f} s | {one['longest']:.2f} s |"
        )
    return "\n".join(lines)


def table() -> str:
    """All tables of the emulation."""
    return "\n\n".join([reductions_table(), runs_table(), agreement_table(), responses_table()])


def first_pair() -> list[RunResult]:
    """The first pair of runs, scaled back to the whole robot, on the time of the trace before its compression."""
    cpu, memory, times = MEASURED["scale"]["cpu"], MEASURED["scale"]["memory"], MEASURED["compress"]
    found = []
    for run in MEASURED["runs"][:2]:
        columns = (run["samples"][name] for name in ("at", "cpu", "memory"))
        samples = tuple(
            Sample(at * times, c / cpu, round(m / memory), frozenset()) for at, c, m in zip(*columns, strict=True)
        )
        seconds = run["seconds"] * times
        found.append(RunResult(run["name"], seconds, samples, cpu_seconds=run["cpu"] / cpu * seconds))
    return found


def plot() -> None:
    """Draws the first pair."""
    trace = read_trace(HERE / f"{MEASURED['trace']}.yaml")
    speed = f"{MEASURED['compress']:g} times as fast"
    note = f"measured on Docker, {speed}, with stand-ins, scaled back to the robot; synthetic weights and trace"
    draw(first_pair(), trace, HERE / "emulation.svg", note)
