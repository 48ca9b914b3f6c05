"""Recomputes the evaluation: figures.json, the plots, the tables of docs/evaluation.md and the figures in README.md.
Takes some minutes of one core.

`python docs/evaluation/evaluate.py`, or `make evaluation`. With `--pages` it only writes the tables again.
"""

from __future__ import annotations

import json
import random
import sys
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from statistics import mean, stdev
from typing import Any

import contended
import emulated
import programmed
import recorded_table
from weights import CLASSES

from rorg.manifest.load import load_or_raise
from rorg.manifest.traces import read_trace
from rorg.manifest.workloads import read_workload
from rorg.model.catalog import Catalog
from rorg.model.trace import Trace
from rorg.model.workload import Behaviour, Distribution, Workload
from rorg.tools.sim.plots import draw
from rorg.tools.sim.report import summary
from rorg.tools.sim.results import RunResult
from rorg.tools.sim.simulate import simulate

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PAGE, README = HERE.parent / "evaluation.md", ROOT / "README.md"
FIGURES = HERE / "figures.json"
BEGIN, END = "<!-- begin: evaluate.py {} -->", "<!-- end: evaluate.py {} -->"
SEEDS = (1, 2, 3, 4, 5)
TRACES = ("day", "hour")
NEVER_TOGETHER = "cartographer"
"""The service that conflicts with others."""
AT_REST = ("start", "charging")
"""States in which the robot does nothing: the paper counts only active time."""
STATES = {"all": "all together", "chat": "greeting", "greet": "greeting"}
"""States that the tables call otherwise."""
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


def active_time(result: RunResult, asked: Trace, states: Collection[str] = ()) -> tuple[float, float]:
    """Mean cores and bytes in these states; by default, while the robot is active."""
    spans = [(a, b) for a, b, _, state in asked.states() if (state in states if states else state not in AT_REST)]
    kept = [s for s in result.samples if any(a < s.at <= b for a, b in spans)]
    return mean(s.cpu for s in kept), mean(s.memory for s in kept)


def less(rorg: float, base: float) -> float:
    """Reduction by rorg, in percent."""
    return 100 * (1 - rorg / base)


def reductions(base: RunResult, rorg: RunResult, asked: Trace, states: Collection[str] = ()) -> dict[str, float]:
    """Reductions in percent, over these states (by default, active time) and over the whole time."""
    before, now = active_time(base, asked, states), active_time(rorg, asked, states)
    return {
        "cpu": less(now[0], before[0]),
        "memory": less(now[1], before[1]),
        "cpu_of_all_time": less(rorg.cpu, base.cpu),
        "memory_of_all_time": less(rorg.memory, base.memory),
    }


def declared(catalog: Catalog) -> dict[str, float]:
    """Cores and GB of everything that can run together, with every program in use: the paper's totals."""
    services = [one for name, one in catalog.services.items() if name != NEVER_TOGETHER]
    return {"cores": sum(one.cpu for one in services), "gb": sum(one.memory for one in services) / 1e9}


def row_of(base: RunResult, rorg: RunResult, asked: Trace, states: Collection[str] = ()) -> dict[str, float]:
    """The figures of one pair of runs: percent, cores and GB."""
    before, now = active_time(base, asked, states), active_time(rorg, asked, states)
    return {
        **reductions(base, rorg, asked, states),
        "cores_all_on": before[0],
        "cores_rorg": now[0],
        "gb_all_on": before[1] / 1e9,
        "gb_rorg": now[1] / 1e9,
        "violations": float(len(rorg.violations)),
    }


def waits(runs: Iterable[RunResult]) -> dict[str, Any]:
    """How long requests took until everything in them was ready, by state: all runs together, in seconds."""
    responses = tuple(one for run in runs for one in run.responses)
    found = summary(RunResult("rorg", 1.0, (), responses))["responses"]
    return {STATES.get(name, name): times for name, times in found.items()}


def spread(rows: Iterable[Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Mean, standard deviation, minimum and maximum of each figure."""
    columns: dict[str, list[float]] = {}
    for row in rows:
        for name, value in row.items():
            columns.setdefault(name, []).append(value)
    return {
        name: {
            "mean": round(mean(values), 4),
            "deviation": round(stdev(values), 4),
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
    names = sorted(n for n, s in catalog.services.items() if not s.meta and n != NEVER_TOGETHER)
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
    """Reductions with different idle actions and lingering, and how long greetings and tours then wait."""
    own: dict[str, dict[str, Any]] = {f"all {action}": {"action": action} for action in ACTIONS}
    own |= {f"linger {linger:g} s": {"linger": linger} for linger in LINGERS}
    policies = {name: idling(catalog, said) for name, said in own.items()}
    found = {}
    for name, changed in policies.items():
        base, rorg = both(changed, asked, workload, 1)
        row, waiting = reductions(base, rorg, asked), waits([rorg])
        found[name] = {k: row[k] for k in ("cpu", "memory")} | {k: waiting[k]["median"] for k in ("greeting", "tour")}
    return found


# -- the robot of real programs ----------------------------------------------------------------------------------------


def of_programs() -> dict[str, Any]:
    """The hour of the robot of real programs: all of it, by state, and if unused programs took another part of their
    CPU."""
    catalog, asked, workload = programmed.robot(), read_trace(programmed.TRACE), read_workload(programmed.WORKLOAD)
    pairs = [both(catalog, asked, workload, seed) for seed in SEEDS]
    rows = [row_of(*pair, asked) for pair in pairs]
    states = {
        state: {what: mean(row_of(*pair, asked, (state,))[what] for pair in pairs) for what in rows[0]}
        for state in programmed.STATES
        if state not in AT_REST
    }
    return {
        "hour": {what: mean(row[what] for row in rows) for what in rows[0]},
        "first": rows[0],
        "states": states,
        "idle use": {programmed.STAY: staying(catalog, asked, workload)} | idle_parts(catalog, asked, workload),
        "waits": waits(rorg for _, rorg in pairs),
    }


def staying(catalog: Catalog, asked: Trace, workload: Workload) -> dict[str, float]:
    """The hour if no subscriber ever leaves, so that detections go on while nobody uses them."""
    stays = {name: replace(workload.of(name), cpu_idle=workload.of(name).cpu) for name in programmed.SUBSCRIBERS}
    changed = replace(workload, services={**workload.services, **stays})
    return reductions(*both(catalog, asked, changed, 1), asked)


# -- files ---------------------------------------------------------------------------------------------------------


def figures() -> dict[str, Any]:
    """All figures of the evaluation."""
    catalog, workload, hour = robot(), weights(), trace("hour")
    found: dict[str, Any] = {"synthetic": True, "seeds": list(SEEDS), "declared": rounded(declared(catalog))}
    for name in TRACES:
        pairs = [both(catalog, trace(name), workload, seed) for seed in SEEDS]
        rows = [row_of(*pair, trace(name)) for pair in pairs]
        found[name] = {**spread(rows), "waits": rounded(waits(rorg for _, rorg in pairs)), "first": rounded(rows[0])}
    found["sensitivity"] = rounded(
        {
            "classes": of_classes(catalog, hour, workload),
            "idle use": idle_parts(catalog, hour, workload),
            "random": at_random(catalog, hour, workload),
            "policies": of_policies(catalog, hour, workload),
        }
    )
    found["programs"] = rounded(of_programs())
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
    contended.plot()


def headline_table(found: Mapping[str, Any]) -> str:
    """What the evaluation says, what that rests on, and what is not known."""
    day, told = found["day"], found["sensitivity"]
    cpu, memory = (day[what]["mean"] for what in ("cpu", "memory"))
    idle = [row["cpu"] for row in told["idle use"].values()]
    actions = [told["policies"][f"all {action}"]["memory"] for action in ("pause", "stop")]
    random_cpu, waiting, kind = told["random"]["cpu"], day["waits"], "simulated day, synthetic"
    return "\n".join(
        [
            "| | everything on | rorg | what this is |",
            "|---|---|---|---|",
            f"| CPU | {_both(day, 'cores', 'cores')} (-{cpu:.0f} %) | {kind}; calibrated to "
            f"{found['declared']['cores']} cores with every program in use |",
            "| the same, if unused programs take none to all of their CPU | | "
            f"{min(idle):.0f} to {max(idle):.0f} % less | simulated hour, synthetic |",
            f"| the same, if the CPU is divided at random among services | | {random_cpu['least']:.0f} to "
            f"{random_cpu['most']:.0f} % less | simulated hour, synthetic |",
            f"| memory | {_both(day, 'gb', 'GB')} (-{memory:.0f} %) | {kind} |",
            f"| the same, if all idle services pause, or all stop | | {actions[0]:.0f} or {actions[1]:.0f} % less "
            "| simulated hour, synthetic |",
            f"| wait for a greeting, median | none | {waiting['greeting']['median']:.1f} s | {kind} |",
            f"| wait for a tour, median | none | {waiting['tour']['median']:.1f} s | {kind} |",
            *programmed.headline_rows(found),
            *emulated.headline_rows(),
            *contended.headline_rows(),
            "| on a robot | not known | not known | we have no robot |",
        ]
    )


def savings(found: Mapping[str, Any]) -> str:
    """The README's paragraph: what is saved, and on what each figure rests."""
    simulated = [f"{found['day'][what]['mean']:.0f} %" for what in ("cpu", "memory")]
    on_docker = [f"{100 * emulated.MEASURED['reductions'][what]['mean']:.0f} %" for what in ("cpu", "memory")]
    everything, shares, rested = contended.missed_deadlines()
    return "\n".join(
        [
            f"**Savings** on the tour-guide robot: {simulated[0]} of the CPU and {simulated[1]} of the memory when "
            f"simulated, {on_docker[0]} and {on_docker[1]} when emulated on Docker.",
            f"Under twice the load, {everything:.0f} % of control deadlines were missed with everything on, "
            f"{shares:.1f} % with CPU shares alone, and {rested:.1f} % with rorg, pauses and shares.",
            "The programs were synthetic, and none of this ran on a robot yet: [the evaluation](docs/evaluation.md).",
        ]
    )


def _both(of: Mapping[str, Any], what: str, unit: str) -> str:
    return " | ".join(f"{of[f'{what}_{how}']['mean']:.2f} {unit}" for how in ("all_on", "rorg"))


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
    return f"-{one['mean']:.1f} %"


def use_table(found: Mapping[str, Any]) -> str:
    declared = found["declared"]
    lines = [
        "| trace | all on, every program in use | all on | rorg | violations |",
        "|---|---|---|---|---|",
    ]
    for name in TRACES:
        of = {k: v["mean"] for k, v in found[name].items() if "mean" in v}
        lines.append(
            f"| {name} | {declared['cores']:.2f} cores, {declared['gb']:.2f} GB "
            f"| {of['cores_all_on']:.2f} cores, {of['gb_all_on']:.2f} GB "
            f"| {of['cores_rorg']:.2f} cores, {of['gb_rorg']:.2f} GB | {of['violations']:g} |"
        )
    return "\n".join(lines)


def waits_table(found: Mapping[str, Any]) -> str:
    lines = ["| trace | request | number | median | 95 % | longest | never ready |", "|---|---|---|---|---|---|---|"]
    for name in TRACES:
        for state, one in found[name]["waits"].items():
            times = " | ".join(f"{one[k]:.2f} s" for k in ("median", "p95", "most"))
            lines.append(f"| {name} | {state} | {one['count']} | {times} | {one['never']} |")
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
        "| policy of all that is not always on | CPU | memory | greeting waits, median | tour waits, median |",
        "|---|---|---|---|---|",
    ]
    for name, row in found["sensitivity"]["policies"].items():
        times = f"{row['greeting']:.2f} s | {row['tour']:.2f} s"
        lines.append(f"| {name} | -{row['cpu']:.1f} % | -{row['memory']:.1f} % | {times} |")
    return "\n".join(lines)


TABLES: Mapping[str, Callable[[Mapping[str, Any]], str]] = {
    "headline": headline_table,
    "savings": savings,
    "reductions": reduction_table,
    "use": use_table,
    "waits": waits_table,
    "sensitivity": sensitivity_table,
    "policies": policy_table,
    "emulation": lambda _: emulated.table(),
    "contention": lambda _: contended.table(),
    "recorded": lambda _: recorded_table.table(),
    "programs": programmed.programs_table,
    "programs saved": programmed.saved_table,
}
PAGES = {PAGE: tuple(name for name in TABLES if name != "savings"), README: ("savings",)}
"""Page -> its tables."""


def page(path: Path, found: Mapping[str, Any]) -> str:
    """The text of a page with tables from these figures."""
    text = path.read_text(encoding="utf-8")
    for name in PAGES[path]:
        begin, end = BEGIN.format(name), END.format(name)
        before, _, rest = text.partition(begin)
        _, marked, after = rest.partition(end)
        assert marked, f"no markers for {name}"
        text = f"{before}{begin}\n\n{TABLES[name](found)}\n\n{end}{after}"
    return text


def main() -> None:
    """With --pages, only writes the tables of what is known into the pages."""
    only_pages = "--pages" in sys.argv
    programmed.write()
    found = json.loads(FIGURES.read_text(encoding="utf-8")) if only_pages else figures()
    FIGURES.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    for path in PAGES:
        path.write_text(page(path, found), encoding="utf-8")
    if not only_pages:
        plots()


if __name__ == "__main__":
    main()
