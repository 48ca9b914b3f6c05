"""rorg simulate"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rorg.cli.context import Context
from rorg.cli.kinds import FILE, Seconds, durations, numbers
from rorg.cli.options import Directory, Output
from rorg.cli.output import disk_errors, note, print_rows
from rorg.errors import Invalid
from rorg.model.units import format_memory

if TYPE_CHECKING:
    from rorg.model.catalog import Catalog
    from rorg.model.trace import Trace
    from rorg.model.workload import Workload
    from rorg.tools.sim.results import RunResult
    from rorg.tools.sim.variants import Tree, Tried, Variant

WorkloadFile = Annotated[
    Path | None,
    typer.Option(
        help="File of a Workload: how programs use the machine. Default: `resources` and `ready` of the manifests.",
        click_type=FILE,
    ),
]
Cores = Annotated[
    float | None,
    typer.Option(
        help="Cores of the machine: while programs want more, each gets its share and comes up more slowly. Default: "
        "there are always enough.",
        metavar="N",
        parser=numbers(0.1),
    ),
]
Plot = Annotated[
    Path | None,
    typer.Option(
        help="Plot CPU, memory and the activity of the robot over time to a .svg, .png or .html.", click_type=FILE
    ),
]
Compare = Annotated[
    list[str],
    typer.Option(
        help="Compare with this variant: a directory of manifests, the file of a Policy, or settings for all "
        "services that are not always on, such as linger=20s,idle=pause. Repeat it for more "
        "variants.",
        metavar="[NAME=]VARIANT",
    ),
]
Sweep = Annotated[
    list[str],
    typer.Option(
        help="Compare all combinations of settings: --sweep linger=0s,20s --sweep idle=pause,stop.",
        metavar="SETTING=VALUES",
    ),
]


def command(
    trace: Annotated[Path, typer.Argument(help="File of a Trace: the requests to replay.", click_type=FILE)],
    directory: Directory = None,
    *,
    workload: WorkloadFile = None,
    seed: Annotated[int, typer.Option(help="Random seed.")] = 1,
    cores: Cores = None,
    every: Annotated[float, typer.Option(help="Time between two samples.", parser=durations(0.01))] = Seconds(1),
    csv: Annotated[Path | None, typer.Option(help="Write the time series to a file.", click_type=FILE)] = None,
    plot: Plot = None,
    compare: Compare = [],  # noqa: B006
    sweep: Sweep = [],  # noqa: B006
    output: Output = "table",
) -> None:
    """Replay a trace on a simulated robot in virtual time, with everything on and with time-sharing: CPU and memory
    used, response times, violations. It uses the same planner as `rorg run`. Nothing is measured: all figures
    follow from the workload or the manifests.

    Example: rorg simulate day.yaml manifests --plot day.png
    """
    from rorg.manifest.traces import read_trace
    from rorg.manifest.workloads import read_workload
    from rorg.model.workload import Workload
    from rorg.tools.sim.variants import Tree

    context = Context(None, None, directory, local=True)
    catalog = context.catalog()
    asked = read_trace(trace, {*catalog.services, *catalog.groups})
    programs = read_workload(workload) if workload else Workload("manifests")
    _warn(catalog, asked, programs)
    trial = Trial(Tree(context.root, catalog, context.engine_name, context.robot), asked, programs, seed, cores)
    if compare or sweep:
        try_out(trial, compare, sweep, output, csv, plot)
    else:
        _simulate(trial, every, output, csv, plot)


def _warn(catalog: Catalog, trace: Trace, workload: Workload) -> None:
    """Notes the services that take time to become ready, if nothing says how long."""
    from rorg.model.causes import Cause
    from rorg.model.graph import closure

    members = {member for event in trace.events for name in event.services for member in catalog.members(name)}
    used = (catalog.services[name] for name in sorted(closure(catalog.services, members)))
    probed = (one.name for one in used if one.ready is not None and one.ready.delay is None)
    if unknown := tuple(name for name in probed if workload.of(name).start is None):
        why = "no start times are known, so requests wait longer than this says"
        note(f"{Cause(unknown, why)}; try `rorg fit --workload FILE`, then `rorg simulate --workload FILE`")


def _simulate(trial: Trial, every: float, output: str, csv: Path | None, plot: Path | None) -> None:
    """Simulates the robot with everything on and with time-sharing, and prints, writes and plots the results."""
    from rorg.tools.sim.report import COLUMNS, SHORT, WIDE, as_json, rows
    from rorg.tools.sim.simulate import simulate

    catalog, asked, programs, seed = trial.tree.catalog, trial.trace, trial.workload, trial.seed
    results = [
        simulate(catalog, asked, programs, seed, name=name, all_on=all_on, every=every, cores=trial.cores)
        for name, all_on in (("all-on", True), ("rorg", False))
    ]
    if csv:
        _write(results, asked, csv)
    if plot:
        from rorg.tools.sim.plots import draw

        draw(results, asked, plot, f"simulated, seed {seed}; synthetic weights: {programs.name}")
    full = {"trace": asked.name, "workload": programs.name, "seed": seed, "runs": as_json(results)}
    columns = COLUMNS if trial.cores is None else (*COLUMNS, SHORT)
    print_rows(rows(results), output, columns, WIDE, full=full)


def _write(results: Sequence[RunResult], trace: Trace, path: Path) -> None:
    """Writes the time series."""
    import csv

    from rorg.tools.sim.report import SERIES, series

    with disk_errors(f"write {path}", "another file by --csv"), path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(SERIES)
        writer.writerows(series(results, trace))


ALL_ON, DECLARED = "all-on", "as-declared"
"""Variants to compare with."""
SHOWN = ("run", "cpu", "memory", "response", "median", "p95", "violations", "calls", "efficient")
ALSO = ("peak_memory", "requests", "unready")


@dataclass(frozen=True)
class Trial:
    """The inputs that all variants are simulated with."""

    tree: Tree
    trace: Trace
    workload: Workload
    seed: int
    cores: float | None = None
    """Cores of the machine; None: there are always enough."""

    def compare(self, texts: Sequence[str]) -> list[Tried]:
        """Everything on, the tree as declared, and these variants. Raises Invalid."""
        from rorg.tools.sim.variants import Variant, variant

        given = [variant(text, self.tree) for text in texts]
        return self._tried([Variant(name, self.tree.catalog) for name in (ALL_ON, DECLARED)] + given)

    def sweep(self, texts: Sequence[str]) -> list[Tried]:
        """The tree as declared, and all combinations. Raises Invalid."""
        from rorg.tools.sim.variants import Variant, sweep

        return self._tried([Variant(DECLARED, self.tree.catalog), *sweep(texts, self.tree)])

    def _tried(self, variants: Sequence[Variant]) -> list[Tried]:
        from rorg.tools.sim.simulate import simulate
        from rorg.tools.sim.variants import tried

        for one in variants:
            self._check(one)
        results = [
            simulate(
                one.catalog,
                self.trace,
                self.workload,
                self.seed,
                name=one.name,
                all_on=one.name == ALL_ON,
                cores=self.cores,
            )
            for one in variants
        ]
        return tried(variants, results)

    def _check(self, variant: Variant) -> None:
        """Raises Invalid for a tree without something that the trace names."""
        known = {*variant.catalog.services, *variant.catalog.groups}
        named = {name for event in self.trace.events for name in (event.requester, *event.services)}
        missing = sorted(named - known)
        if missing:
            why = f"the trace {self.trace.name} names {missing[0]}, which it does not declare"
            raise Invalid(f"try '{variant.name}'", why, "a tree that declares everything in the trace")


def try_out(
    trial: Trial, compare: Sequence[str], sweep: Sequence[str], output: str, csv: Path | None, plot: Path | None
) -> None:
    """Does what the options say. Raises Invalid."""
    if compare and sweep:
        raise Invalid("try variants", "--compare and --sweep are mutually exclusive", "one of them")
    variants = trial.compare(compare) if compare else trial.sweep(sweep)
    if csv:
        write_csv(variants, csv)
    if plot:
        draw(trial, variants, plot)
    show(variants, output, trial.cores)


def draw(trial: Trial, variants: Sequence[Tried], file: Path) -> None:
    """Draws the plot. Raises Invalid."""
    from rorg.plots.figure import save
    from rorg.tools.sim.plots import draw_sweep

    note = f"Simulated, seed {trial.seed}; synthetic weights: {trial.workload.name}."
    save(lambda: draw_sweep(variants, trial.trace.name, note), file)


def show(variants: Sequence[Tried], output: str, cores: float | None = None) -> None:
    """Prints a table. Response times (mean, median, 95th percentile) are of the requests that take any time in at least
    one variant; efficient: no other variant is better in CPU, memory and mean response time."""
    full = [one.as_json() for one in variants]
    rows = [
        {
            **one,
            "cpu": f"{one['cpu']:.2f}",
            "response": f"{one['response_mean']:.2f} s",
            "median": f"{one['response_median']:.2f} s",
            "p95": f"{one['response_p95']:.2f} s",
            **{key: format_memory(one[key]) for key in ("memory", "peak_memory")},
            "efficient": "*" if one["efficient"] else "",
        }
        for one in full
    ]
    print_rows(rows, output, SHOWN if cores is None else (*SHOWN, "cpu_short"), ALSO, full=full)


def write_csv(variants: Sequence[Tried], file: Path) -> None:
    """Writes a line for each variant, with a column for each setting. Raises Invalid."""
    import csv

    rows = [{**one.as_json(), **one.variant.settings} for one in variants]
    settings = dict.fromkeys(key for one in variants for key in one.variant.settings)
    columns = ["run", *settings, *(key for key in variants[0].as_json() if key not in ("run", "settings"))]
    with disk_errors(f"write {file}", "another file"), file.open("w", newline="") as to:
        writer = csv.DictWriter(to, columns, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
