"""Turns contention.json into a table and a plot for docs/evaluation.md. contention.py writes that file; nothing here
measures."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from math import ceil, sqrt
from pathlib import Path
from statistics import mean, stdev
from typing import TYPE_CHECKING, Any, NamedTuple

from rorg.plots.figure import save

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HERE = Path(__file__).parent
FILE, PLOT = HERE / "contention.json", HERE / "contention.svg"
WAYS = {
    "all-on": "everything on",
    "shares": "everything on, CPU shares",
    "script": "start-stop script",
    "rorg": "rorg",
    "rested": "rorg, pauses and CPU shares",
}
"""Names of the ways to run the robot, as in the file and as readers see them."""
REQUESTS = (
    ("greeting", "chat", 0),
    ("tour", "tour", 0),
    ("return", "return", 0),
    ("standby after it", "standby", 0),
    ("second greeting", "chat", 1),
)
"""Requests of the tour whose times are shown, as readers call them: state, and number among those of that state."""
PICTURE = f"![Deadlines missed, time until the robot moves, and time of the tour](evaluation/{PLOT.name})"
T95 = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131)
"""Student's t for two-sided intervals of 95 %, for 1 degree of freedom and more."""
INK, QUIET = "#0550ae", "#59636e"


# -- statistics --------------------------------------------------------------------------------------------------------


def latencies(rounds: Sequence[tuple[float, float]], period: float) -> Iterator[float]:
    """Seconds from each tick of a control loop until its output. `rounds`: when each was due and done. A tick that the
    loop skipped, because it was late, waits for the next output."""
    for (due, done), (next_due, next_done) in pairwise(rounds):
        yield done - due
        for skipped in range(1, round((next_due - due) / period)):
            yield next_done - due - skipped * period
    if rounds:
        due, done = rounds[-1]
        yield done - due


def missed(seconds: Sequence[float], deadline: float) -> float:
    """Percent of latencies that are longer than the deadline."""
    return 100 * sum(one > deadline for one in seconds) / len(seconds)


def percentile(values: Sequence[float], part: float) -> float:
    """The least value that `part` (above 0, up to 1) of the values do not exceed."""
    return sorted(values)[ceil(part * len(values)) - 1]


class Estimate(NamedTuple):
    """A mean and half the width of its 95 % interval, by Student's t over independent runs."""

    mean: float
    half: float | None
    """None for a single run."""


def estimate(values: Sequence[float]) -> Estimate:
    if len(values) < 2:
        return Estimate(mean(values), None)
    t = T95[min(len(values) - 1, len(T95)) - 1]
    return Estimate(mean(values), t * stdev(values) / sqrt(len(values)))


# -- figures -----------------------------------------------------------------------------------------------------------


def measured() -> Mapping[str, Any]:
    return json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {"levels": {}}


class Row(NamedTuple):
    """A row of the table."""

    title: str
    form: str
    of: Callable[[Mapping[str, Any]], float]
    """The figure of one run."""


def ready_in(state: str, number: int) -> Callable[[Mapping[str, Any]], float]:
    return lambda run: run["ready"][state][number]


CONTROL = Row("control loop: deadlines missed (%)", ".1f", lambda run: run["control"]["missed"])
MOVES = Row('from "please follow me" until it moves (s)', ".2f", lambda run: run["moves"])
TOUR = Row("the whole tour (s)", ".1f", lambda run: run["seconds"])
FIGURES = (
    CONTROL,
    *(
        Row(f"control loop: latency, {name} (ms)", ".1f", lambda run, name=name: 1000 * run["control"][name])
        for name in ("p50", "p95", "p99")
    ),
    *(Row(f"from request to ready: {title} (s)", ".2f", ready_in(state, n)) for title, state, n in REQUESTS),
    MOVES,
    TOUR,
    Row("CPU (cores)", ".2f", lambda run: run["cpu"]["cores"]),
    Row("CPU seconds for the tour", ".0f", lambda run: run["cpu"]["cores"] * run["seconds"]),
    Row("of that: engine, script or rorg, measurement", ".1f", lambda run: run["cpu"]["engine"] * run["seconds"]),
    Row("memory, mean (GB)", ".2f", lambda run: run["memory"]["mean"] / 1e9),
    Row("page faults (thousands)", ".0f", lambda run: run["faults"]["minor"] / 1000),
    Row("of that: from disk", ".0f", lambda run: run["faults"]["major"]),
)


def runs_of(level: Mapping[str, Any], way: str) -> list[Mapping[str, Any]]:
    return [run for run in level["runs"] if run["way"] == way]


def shown(figure: Row, runs: Sequence[Mapping[str, Any]]) -> str:
    value, half = estimate([figure.of(run) for run in runs])
    return f"{value:{figure.form}}" + ("" if half is None else f" ± {half:{figure.form}}")


def summary(run: Mapping[str, Any]) -> str:
    """A line about a run, while the measurement goes on."""
    return (
        f"round {run['round']}, {run['way']}: {run['seconds']:.1f} s, {run['control']['missed']:.1f} % missed, "
        f"moves after {run['moves']:.2f} s, others used {run['other']:.2f} cores"
    )


def ways_of(level: Mapping[str, Any]) -> list[str]:
    return [way for way in WAYS if runs_of(level, way)]


def table() -> str:
    """A table for each level of demand, with the conditions under which it was measured, and the plot."""
    found = measured()
    if not found["levels"]:
        return "Not measured yet: `make contention`."
    return "\n\n".join([*(_table(level) for _, level in sorted(found["levels"].items())), PICTURE])


def headline_rows() -> list[str]:
    """What a short CPU does to the control loop, with and without rorg, for each level of demand."""
    rows = []
    for _, level in sorted(measured()["levels"].items()):
        on, shares, rorg, rested = (
            f"{estimate([CONTROL.of(run) for run in runs_of(level, way)]).mean:.1f} %"
            for way in ("all-on", "shares", "rorg", "rested")
        )
        rows.append(
            f"| deadlines missed if programs want {level['demand']:g} times the CPU | {on}; {shares} with CPU shares "
            f"| {rorg}; {rested} with CPU shares and pauses | measured on Docker, synthetic |"
        )
    return rows


def missed_deadlines() -> tuple[float, ...]:
    """Deadlines of the control loop that were missed at twice the demand, in percent: with everything on, with CPU
    shares alone, and with rorg, pauses and shares."""
    level = measured()["levels"]["2"]
    return tuple(
        estimate([CONTROL.of(run) for run in runs_of(level, way)]).mean for way in ("all-on", "shares", "rested")
    )


def _table(level: Mapping[str, Any]) -> str:
    machine, ways = level["machine"], ways_of(level)
    lines = [f"Demand of {level['demand']:g} times the {machine['cores']} cores:", ""]
    lines += [f"| | {' | '.join(WAYS[way] for way in ways)} |", "|---" * (len(ways) + 1) + "|"]
    lines += [f"| {one.title} | {' | '.join(shown(one, runs_of(level, w)) for w in ways)} |" for one in FIGURES]
    return "\n".join([*lines, "", _conditions(level)])


def _conditions(level: Mapping[str, Any]) -> str:
    machine, runs = level["machine"], level["runs"]
    other = max(run["other"] for run in runs) / machine["cores"]
    rounds, again = len({run["round"] for run in runs}), level["repeated"]
    return (
        f"Mean of {rounds} runs of each, in turn, ± 95 % (Student's t). {machine['cpu']}, {machine['cores']} cores, "
        f"Linux {machine['kernel']}, cgroups v{machine['cgroups']}, Docker {machine['docker']}, {machine['compose']}. "
        f"Load average before: {level['load']:.1f}. Other programs used at most {other:.0%} of the CPU; "
        f"{again} runs were repeated because they used more than 10 %."
    )


# -- plot --------------------------------------------------------------------------------------------------------------


def plot() -> None:
    """Draws three figures of all levels, if there are any."""
    if found := measured()["levels"]:
        save(lambda: _drawn([level for _, level in sorted(found.items())]), PLOT)


def _drawn(levels: Sequence[Mapping[str, Any]]) -> Figure:
    """A row for each level, a panel for each figure; a dot for each run, a line for the interval of the mean."""
    from matplotlib.figure import Figure

    figures = (CONTROL, MOVES, TOUR)
    figure = Figure(figsize=(10, 1.9 * len(levels) + 0.7), layout="constrained")
    rows: Any = figure.subplots(len(levels), len(figures), squeeze=False, sharex="col", sharey=True)
    for panels, level in zip(rows, levels, strict=True):
        for axes, one in zip(panels, figures, strict=True):
            _panel(axes, one, level)
        cores = level["machine"]["cores"]
        panels[0].set_title(f"demand: {level['demand']:g} x {cores} cores", loc="left", fontweight="bold", fontsize=9)
    for axes, one in zip(rows[-1], figures, strict=True):
        axes.set_xlabel(one.title)
        axes.set_xlim(left=0)
    note = "dots: runs; bars: mean and 95 % interval; measured on Docker with stand-ins"
    figure.supxlabel(note, x=0.01, ha="left", fontsize=7, color=QUIET)
    return figure


def _panel(axes: Axes, one: Row, level: Mapping[str, Any]) -> None:
    ways = ways_of(level)
    for row, way in enumerate(ways):
        values = [one.of(run) for run in runs_of(level, way)]
        value, half = estimate(values)
        axes.plot(values, [row + 0.18] * len(values), "o", color=QUIET, markersize=3, alpha=0.6)
        axes.errorbar(value, row - 0.12, xerr=half, fmt="|", color=INK, markersize=9, capsize=3, linewidth=1.5)
    axes.set_yticks(range(len(ways)), [WAYS[way] for way in ways])
    axes.set_ylim(len(ways) - 0.5, -0.5)
    axes.grid(axis="x", alpha=0.3)
    axes.tick_params(left=False)
    axes.spines[["top", "right", "left"]].set_visible(False)
