"""Recomputes the evaluation: figures.json, the plots, and the tables of docs/evaluation.md. Takes a minute of one core.

`python docs/evaluation/evaluate.py`, or `make evaluation`.
"""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from statistics import mean, median, stdev
from typing import Any

import emulated
from weights import CLASSES

from rorg.manifest.load import load_or_raise
from rorg.manifest.traces import read_trace
from rorg.manifest.workloads import read_workload
from rorg.model.catalog import Catalog
from rorg.model.trace import Trace
from rorg.model.workload import Behaviour, Distribution, Workload
from rorg.tools.sim.plots import draw
from rorg.tools.sim.results import RunResult
from rorg.tools.sim.simulate import simulate

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PAGE = HERE.parent / "evaluation.md"
FIGURES = HERE / "figures.json"
BEGIN, END = "<!-- begin: evaluate.py {} -->", "<!-- end: evaluate.py {} -->"
SEEDS = (1, 2, 3, 4, 5)
TRACES = ("day", "hour")
AT_REST = ("start", "charging")
"""States in which the robot does nothing: the paper counts only active time."""
REWEIGHTED = 20
FACTORS = (0.5, 2.0)
LINGERS = (0.0, 2.0, 10.0, 60.0)
ACTIONS = ("pause", "stop", "remove")
PAPER = {
    "simulation, 4 h, 188 greetings, 10 tours": (52.6, 12.5),
    "emulation": (37.2, 40.2),
    "deployment, 60 min, 30 greetings, 3 tours": (45.5, 16.5),
}
"""Reductions of CPU and memory, percent."""


def robot() -> Catalog:
    return load_or_raise(ROOT / "manifests")


def trace(name: str) -> Trace:
    return read_trace(HERE / f"{name}.yaml")


def weights() -> Workload:
    return read_workload(HERE / "workload.yaml")


def both(catalog: Catalog, asked: Trace, workload: Workload, seed: int) -> tuple[RunResult, RunResult]:
    """Returns two runs: with everything on, and with time-sharing."""
    base = simulate(catalog, asked, workload, seed, name="all-on", all_on=True)
    return base, simulate(catalog, asked, workload, seed)


def active_time(result: RunResult, asked: Trace) -> tuple[float, float]:
    """Mean cores and bytes while the robot is active."""
    spans = [(a, b) for a, b, _, state in asked.states() if state not in AT_REST]
    kept = [s for s in result.samples if any(a < s.at <= b for a, b in spans)]
    return mean(s.cpu for s in kept), mean(s.memory for s in kept)


def less(rorg: float, base: float) -> float:
    """Reduction by rorg, in percent."""
    return 100 * (1 - rorg / base)


def reductions(base: RunResult, rorg: RunResult, asked: Trace) -> dict[str, float]:
    """Reductions in percent, over active time and over the whole time."""
    before, now = active_time(base, asked), active_time(rorg, asked)
    return {
        "cpu": less(now[0], before[0]),
        "memory": less(now[1], before[1]),
        "cpu_of_all_time": less(rorg.cpu, base.cpu),
        "memory_of_all_time": less(rorg.memory, base.memory),
    }


def of_one_seed(catalog: Catalog, asked: Trace, workload: Workload, seed: int) -> dict[str, float]:
    """The figures of one pair of runs: percent, cores, GB and seconds."""
    return row_of(*both(catalog, asked, workload, seed), asked)


def row_of(base: RunResult, rorg: RunResult, asked: Trace) -> dict[str, float]:
    """The same from two finished runs."""
    before, now = active_time(base, asked), active_time(rorg, asked)
    times = sorted(r.seconds for r in rorg.responses if r.seconds is not None)
    return {
        **reductions(base, rorg, asked),
        "cores_all_on": before[0],
        "cores_rorg": now[0],
        "gb_all_on": before[1] / 1e9,
        "gb_rorg": now[1] / 1e9,
        "ready_median": median(times),
        "ready_p95": times[int(0.95 * len(times))],
        "never_ready": float(len(rorg.responses) - len(times)),
        "violations": float(len(rorg.violations)),
    }


def spread(rows: Iterable[Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Mean, standard deviation, minimum and maximum of each figure."""
    columns: dict[str, list[float]] = {}
    for row in rows:
        for name, value in row.items():
            columns.setdefault(name, []).append(value)
    return {
        name: {
            "mean": round(mean(values), 4),
            "deviation": round(stdev(values), 4) if len(values) > 1 else 0.0,
            "least": round(min(values), 4),
            "most": round(max(values), 4),
        }
        for name, values in columns.items()
    }


# -- sensitivity -------------------------------------------------------------------------------------------------------


def scaled(one: Distribution | None, factor: float) -> Distribution | None:
    return one and Distribution(tuple(v * factor for v in one.values), one.deviation * factor)


def reweighted(catalog: Catalog, workload: Workload, factors: Mapping[str, tuple[float, float]]) -> Workload:
    """The workload with CPU and memory of each service multiplied by its factors."""
    services = dict(workload.services)
    for name, (cpu, memory) in factors.items():
        one = workload.of(name)
        services[name] = replace(
            one,
            cpu=scaled(one.cpu, cpu),
            cpu_idle=scaled(one.cpu_idle, cpu),
            memory=Distribution((catalog.services[name].memory * memory,)),
        )
    return replace(workload, services=services)


def of_classes(catalog: Catalog, asked: Trace, workload: Workload) -> dict[str, Any]:
    """Reductions if one class of programs uses half, or twice, as much."""
    found = {}
    for kind, one in CLASSES.items():
        for factor in FACTORS:
            changed = reweighted(catalog, workload, dict.fromkeys(one.services, (factor, factor)))
            found[f"{kind} x {factor:g}"] = reductions(*both(catalog, asked, changed, 1), asked)
    return found


def idle_parts(catalog: Catalog, asked: Trace, workload: Workload) -> dict[str, Any]:
    """Reductions if every unused program takes this part of its CPU, regardless of its class."""
    found = {}
    for part in (0.0, 0.1, 0.5, 1.0):
        services: dict[str, Behaviour] = {
            n: replace(b, cpu_idle=scaled(b.cpu, part)) for n, b in workload.services.items()
        }
        changed = replace(workload, services=services)
        found[f"idle at {part:g} of active"] = reductions(*both(catalog, asked, changed, 1), asked)
    return found


def at_random(catalog: Catalog, asked: Trace, workload: Workload) -> dict[str, Any]:
    """Reductions with random weights: every division of the same totals is equally likely."""
    names = sorted(n for n, s in catalog.services.items() if not s.meta and n != "cartographer")
    totals = sum(catalog.services[n].cpu for n in names), sum(catalog.services[n].memory for n in names)
    rng, rows = random.Random("reweighting"), []
    # A service that takes no CPU stays at zero.
    own = [n for n in names if catalog.services[n].cpu]
    for _ in range(REWEIGHTED):
        cpus, memories = ([rng.expovariate(1.0) for _ in those] for those in (own, names))
        cpu = {n: totals[0] * x / sum(cpus) / catalog.services[n].cpu for n, x in zip(own, cpus, strict=True)}
        memory = {
            n: totals[1] * x / sum(memories) / catalog.services[n].memory for n, x in zip(names, memories, strict=True)
        }
        changed = reweighted(catalog, workload, {n: (cpu.get(n, 1.0), memory[n]) for n in names})
        rows.append(reductions(*both(catalog, asked, changed, 1), asked))
    return spread(rows)


def idling(catalog: Catalog, said: Mapping[str, Any]) -> Catalog:
    """The catalog with another idle policy for everything that is not always on."""
    services = {
        n: s if s.meta or s.always_on else replace(s, idle=replace(s.idle, **said)) for n, s in catalog.services.items()
    }
    return replace(catalog, services=services)


def of_policies(catalog: Catalog, asked: Trace, workload: Workload) -> dict[str, Any]:
    """Reductions with different idle actions and lingering, and how long requests then take."""
    own: dict[str, dict[str, Any]] = {f"all {action}": {"action": action} for action in ACTIONS}
    own |= {f"linger {linger:g} s": {"linger": linger} for linger in LINGERS}
    policies = {name: idling(catalog, said) for name, said in own.items()}
    found = {}
    for name, changed in policies.items():
        row = of_one_seed(changed, asked, workload, 1)
        found[name] = {k: row[k] for k in ("cpu", "memory", "ready_median", "ready_p95")}
    return found


# -- files ---------------------------------------------------------------------------------------------------------


def figures() -> dict[str, Any]:
    """All figures of the evaluation."""
    catalog, workload, hour = robot(), weights(), trace("hour")
    found: dict[str, Any] = {"synthetic": True, "seeds": list(SEEDS)}
    for name in TRACES:
        rows = [of_one_seed(catalog, trace(name), workload, seed) for seed in SEEDS]
        found[name] = {**spread(rows), "first": rounded(rows[0])}
    found["sensitivity"] = rounded(
        {
            "classes": of_classes(catalog, hour, workload),
            "idle use": idle_parts(catalog, hour, workload),
            "random": at_random(catalog, hour, workload),
            "policies": of_policies(catalog, hour, workload),
        }
    )
    return found


def rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: rounded(v) for k, v in value.items()}
    return round(value, 4) if isinstance(value, float) else value


def plots() -> None:
    """Draws the plots, from one seed."""
    catalog, workload = robot(), weights()
    for name in TRACES:
        asked = trace(name)
        note = "simulated, seed 1; synthetic weights and trace: nothing of this was measured"
        draw(both(catalog, asked, workload, 1), asked, HERE / f"{name}.svg", note)
    emulated.plot()


def reduction_table(found: Mapping[str, Any]) -> str:
    lines = ["| | CPU | memory |", "|---|---|---|"]
    for name, (cpu, memory) in PAPER.items():
        lines.append(f"| paper: {name} | -{cpu} % | -{memory} % |")
    for name in TRACES:
        told = [_percent(found[name][k]) for k in ("cpu", "memory")]
        all_time = [_percent(found[name][f"{k}_of_all_time"]) for k in ("cpu", "memory")]
        lines.append(f"| ours: simulation of {name}.yaml | {told[0]} | {told[1]} |")
        lines.append(f"| the same, with charging and start | {all_time[0]} | {all_time[1]} |")
    return "\n".join([*lines, emulated.reduction_row()])


def _percent(one: Mapping[str, float]) -> str:
    return f"-{one['mean']:.1f} % (± {one['deviation']:.1f})"


def use_table(found: Mapping[str, Any]) -> str:
    lines = [
        "| trace | all on | rorg | ready after, median | 95 % | never ready | violations |",
        "|---|---|---|---|---|---|---|",
    ]
    for name in TRACES:
        of = {k: v["mean"] for k, v in found[name].items() if k != "first"}
        lines.append(
            f"| {name} | {of['cores_all_on']:.2f} cores, {of['gb_all_on']:.2f} GB "
            f"| {of['cores_rorg']:.2f} cores, {of['gb_rorg']:.2f} GB "
            f"| {of['ready_median']:.2f} s | {of['ready_p95']:.2f} s | {of['never_ready']:g} | {of['violations']:g} |"
        )
    return "\n".join(lines)


def sensitivity_table(found: Mapping[str, Any]) -> str:
    told = found["sensitivity"]
    lines = ["| variation | CPU | memory |", "|---|---|---|"]
    for group in ("classes", "idle use"):
        lines += [f"| {name} | -{row['cpu']:.1f} % | -{row['memory']:.1f} % |" for name, row in told[group].items()]
    cpu, memory = ((told["random"][k]["mean"], told["random"][k]["deviation"]) for k in ("cpu", "memory"))
    ends = [(told["random"][k]["least"], told["random"][k]["most"]) for k in ("cpu", "memory")]
    lines.append(
        f"| weights at random, n = {REWEIGHTED}: mean ± deviation | -{cpu[0]:.1f} % ± {cpu[1]:.1f} "
        f"| -{memory[0]:.1f} % ± {memory[1]:.1f} |"
    )
    lines.append(f"| the same: least to most | {_range(ends[0])} | {_range(ends[1])} |")
    return "\n".join(lines)


def _range(ends: tuple[float, float]) -> str:
    return f"-{ends[0]:.1f} % to -{ends[1]:.1f} %"


def policy_table(found: Mapping[str, Any]) -> str:
    lines = [
        "| policy of all that is not always on | CPU | memory | ready after, median | 95 % |",
        "|---|---|---|---|---|",
    ]
    for name, row in found["sensitivity"]["policies"].items():
        times = f"{row['ready_median']:.2f} s | {row['ready_p95']:.2f} s"
        lines.append(f"| {name} | -{row['cpu']:.1f} % | -{row['memory']:.1f} % | {times} |")
    return "\n".join(lines)


TABLES: Mapping[str, Callable[[Mapping[str, Any]], str]] = {
    "reductions": reduction_table,
    "use": use_table,
    "sensitivity": sensitivity_table,
    "policies": policy_table,
    "emulation": lambda _: emulated.table(),
}


def page(text: str, found: Mapping[str, Any]) -> str:
    """The text of the page with tables from these figures."""
    for name, table in TABLES.items():
        begin, end = BEGIN.format(name), END.format(name)
        before, _, rest = text.partition(begin)
        _, marked, after = rest.partition(end)
        assert marked, f"no markers for {name}"
        text = f"{before}{begin}\n\n{table(found)}\n\n{end}{after}"
    return text


def main() -> None:
    found = figures()
    FIGURES.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8"), found), encoding="utf-8")
    plots()


if __name__ == "__main__":
    main()
