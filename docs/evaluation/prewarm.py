"""Evaluates prewarming on days that it has not learned from: writes prewarm.json, and the table in prewarm.md.

`prewarm.py [--check]`; with --check it only checks that the table matches the figures."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from statistics import mean, median, quantiles
from typing import Any

from rorg.core.prediction import learn
from rorg.manifest.load import load_or_raise
from rorg.manifest.traces import read_trace
from rorg.manifest.workloads import read_workload
from rorg.model.catalog import Catalog
from rorg.model.trace import Trace
from rorg.model.workload import Workload
from rorg.tools.sim.generate import generate_day
from rorg.tools.sim.results import RunResult
from rorg.tools.sim.simulate import simulate
from rorg.tools.sim.variants import Tree, sweep

HERE = Path(__file__).parent
MANIFESTS, FIGURES, PAGE = HERE.parents[1] / "manifests", HERE / "prewarm.json", HERE / "prewarm.md"
BEGIN, END = "<!-- begin: prewarm.py -->", "<!-- end: prewarm.py -->"
SETTINGS = ("off", "auto", "0.05", "0.02", "0.01", "0.05, drivers too")
LEARNT, HELD_OUT = 1, (2, 3, 4, 5)
"""Seeds of days."""
HEAD = "| `prewarm` | greetings: median, p95 (s) | tours: median, p95 (s) | CPU (cores) | memory (MiB) | engine calls |"
STATES = {"chat": "greetings", "tour": "tours"}


def day(seed: int) -> Trace:
    return generate_day(4 * 3600, 188, 10, seed)


def workload() -> Workload:
    return read_workload(HERE / "workload.yaml")


def evaluate(traces: Mapping[str, Iterable[Trace]], settings: Iterable[str] = SETTINGS) -> list[dict[str, Any]]:
    """One row per setting: cost of the traces, and how long greetings and tours take to begin. `traces`: name -> traces
    that are counted together."""
    known, use = learn(day(LEARNT).events), workload()
    tree = Tree(MANIFESTS, load_or_raise(MANIFESTS))
    rows = []
    for setting in settings:
        catalog, row = tried(setting, tree), dict[str, Any](prewarm=setting)
        for name, several in traces.items():
            row[name] = figures([simulate(catalog, t, use, n, learned=known) for n, t in enumerate(several)])
        rows.append(row)
    return rows


def tried(setting: str, tree: Tree) -> Catalog:
    """The manifests with this setting. A Policy excludes drivers; with "drivers too" each driver gets it too."""
    value, drivers, _ = setting.partition(", drivers too")
    catalog = sweep([f"prewarm={value}"], tree)[0].catalog
    moving = {n: s for n, s in catalog.services.items() if drivers and s.driver and not s.always_on}
    own = {n: replace(s, idle=replace(s.idle, prewarm=float(value))) for n, s in moving.items()}
    return replace(catalog, services={**catalog.services, **own})


def figures(runs: list[RunResult]) -> dict[str, Any]:
    """Means over runs; response times of all runs together, in seconds."""
    found: dict[str, Any] = {
        "cpu": round(mean(r.cpu for r in runs), 4),
        "memory": round(mean(r.memory for r in runs) / (1 << 20), 1),
        "calls": round(mean(sum((r.actions or {}).values()) for r in runs), 1),
        "violations": sum(len(r.violations) for r in runs),
    }
    for state, name in STATES.items():
        times = [r.seconds for run in runs for r in run.responses if r.state == state]
        known = sorted(t for t in times if t is not None)
        p95 = quantiles(known, n=20, method="inclusive")[-1]
        found[name] = {
            "count": len(times),
            "unready": times.count(None),
            "median": round(median(known), 3),
            "p95": round(p95, 3),
        }
    return found


def table(rows: list[dict[str, Any]]) -> str:
    """The table for the page."""
    lines = []
    for name, title in (("days", "Four days of 4 h, seeds 2 to 5"), ("hour", "The hour")):
        lines += [f"{title}:", "", HEAD, "|---|---|---|---|---|---|"]
        base = rows[0][name]
        for row in rows:
            one = row[name]
            times = " | ".join(f"{one[s]['median']:.2f}, {one[s]['p95']:.2f}" for s in STATES.values())
            cpu, memory = one["cpu"] / base["cpu"] - 1, one["memory"] / base["memory"] - 1
            more = "" if row is rows[0] else f" ({cpu:+.1%})", "" if row is rows[0] else f" ({memory:+.1%})"
            lines.append(
                f"| {row['prewarm']} | {times} | {one['cpu']:.3f}{more[0]} | {one['memory']:.0f}{more[1]} "
                f"| {one['calls']:.0f} |"
            )
        lines.append("")
    return "\n".join(lines)


def written(page: str, rows: list[dict[str, Any]]) -> str:
    """The text of the page with this table."""
    before, _, rest = page.partition(BEGIN)
    return f"{before}{BEGIN}\n\n{table(rows)}\n{END}{rest.partition(END)[2]}"


def main() -> int:
    page = PAGE.read_text(encoding="utf-8")
    if "--check" in sys.argv:
        return int(written(page, json.loads(FIGURES.read_text(encoding="utf-8"))) != page)
    hour = read_trace(HERE / "hour.yaml")
    rows = evaluate({"days": [day(seed) for seed in HELD_OUT], "hour": [hour]})
    FIGURES.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(written(page, rows), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
