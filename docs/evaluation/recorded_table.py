"""Turns recorded.json into tables for docs/evaluation.md. `make recorded` writes that file; nothing here measures."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

FILE = Path(__file__).parent / "recorded.json"
Row = tuple[str, float, str]
"""A figure, and how it is written."""


def error(simulated: float, recorded: float) -> str:
    """The relative error of a simulation."""
    if not recorded:
        return "0.0 %" if simulated == recorded else "-"
    return f"{100 * (simulated / recorded - 1):+.1f} %"


def rows(one: Mapping[str, Any]) -> Iterator[Row]:
    """The figures of a run, in the order of the table."""
    yield "engine calls", sum(one["calls"].values()), ".0f"
    yield "CPU, cores", one["cpu"], ".3f"
    yield "memory, MB", one["memory"] / 1e6, ".0f"
    for word in ("median", "sum", "longest"):
        yield f"wait, {word}, s", one["waits"][word], ".2f"


def calls(*runs: Mapping[str, Any]) -> Iterator[tuple[str, tuple[float, ...]]]:
    """Calls of each verb in each run."""
    for verb in sorted({verb for run in runs for verb in run["calls"]}):
        yield verb, tuple(run["calls"].get(verb, 0) for run in runs)


def _compared(name: str, recorded: Mapping[str, Any], *simulated: Mapping[str, Any]) -> Iterator[str]:
    for (what, value, form), *others in zip(rows(recorded), *map(rows, simulated), strict=True):
        cells = (f"{other:{form}} | {error(other, value)}" for _, other, _ in others)
        yield f"| {name} | {what} | {value:{form}} | {' | '.join(cells)} |"


def robots_table(found: Mapping[str, Any]) -> str:
    """Recorded days beside their simulations."""
    lines = [
        "| robot | | recorded | simulated, learnt | error | simulated, manifests alone | error |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, one in found["robots"].items():
        recorded, simulated = one["recorded"], (one["learnt"], one["declared"])
        lines += _compared(name, recorded, *simulated)
        for verb, (first, *others) in calls(recorded, *simulated):
            cells = " | ".join(f"{n} | {n - first:+d}" for n in others)
            lines.append(f"| {name} | calls: {verb} | {first} | {cells} |")
        for what, word in (("services at moments", "services"), ("whole sets", "sets")):
            cells = " | ".join(f"{run['agreement'][word]:.1%} | " for run in simulated)
            lines.append(f"| {name} | agree: {what} | | {cells} |")
    return "\n".join(lines)


def short_table(found: Mapping[str, Any]) -> str:
    """Days on which the CPU was short beside their simulations."""
    cores = f"--cores {found['cores']:g}"
    lines = [
        f"| burners want | | recorded | simulated, `{cores}` | error | simulated, enough cores | error |",
        "|---|---|---|---|---|---|---|",
    ]
    for times, one in found["short"].items():
        name = f"{float(times) * found['cores']:g} of {found['cores']:g} cores"
        lines += _compared(name, one["recorded"], one["limited"], one["unlimited"])
        short = one["limited"]["short"]
        lines.append(f"| {name} | CPU short, s | | {short['seconds']:.1f} | | 0 | |")
        lines.append(f"| {name} | core seconds short | | {short['core_seconds']:.1f} | | 0 | |")
    return "\n".join(lines)


def table() -> str:
    """Both tables."""
    found = json.loads(FILE.read_text(encoding="utf-8"))
    return f"{robots_table(found)}\n\nThe CPU is short:\n\n{short_table(found)}"
