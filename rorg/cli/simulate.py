"""rorg simulate"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rorg.cli.options import FILES, Argument, Directory, Option, Output, duration

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rorg.model.learned import Learned
    from rorg.model.trace import Trace
    from rorg.sim.results import RunResult


def command(
    trace: Annotated[Path, Argument("File of a Trace: the requests to replay.", completes=FILES)],
    directory: Directory = None,
    workload: Annotated[
        Path | None,
        Option(
            "File of a Workload: how programs use the machine. Default: `resources` and `ready` of the manifests.",
            completes=FILES,
        ),
    ] = None,
    seed: Annotated[int, Option("Random seed.")] = 1,
    learn: Annotated[
        Path | None,
        Option(
            "File of another Trace, from which to learn prewarming before the first one begins. Default: "
            "learn during the first one.",
            metavar="TRACE",
            completes=FILES,
        ),
    ] = None,
    every: Annotated[float, Option("Time between two samples.", parser=duration, least=0.01)] = 1.0,
    csv: Annotated[Path | None, Option("Write the time series to a file.", completes=FILES)] = None,
    plot: Annotated[
        Path | None,
        Option("Plot CPU, memory and the activity of the robot over time to a .png or .svg.", completes=FILES),
    ] = None,
    compare: Annotated[
        list[str],
        Option(
            "Compare with this variant: a directory of manifests, the file of a Policy, or settings for all "
            "services that are not always on, such as linger=20s,idle=pause,prewarm=auto. Repeat it for more "
            "variants.",
            metavar="[NAME=]VARIANT",
        ),
    ] = [],  # noqa: B006
    sweep: Annotated[
        list[str],
        Option(
            "Compare all combinations of settings: --sweep linger=0s,20s --sweep idle=pause,stop.",
            metavar="SETTING=VALUES",
        ),
    ] = [],  # noqa: B006
    output: Output = "table",
) -> None:
    """Replay a trace on a simulated robot in virtual time, with everything on and with time-sharing: CPU and memory
    used, response times, violations. It uses the same planner as `rorg run`. Nothing is measured: all figures
    follow from the workload or the manifests.

    Example: rorg simulate day.yaml manifests --plot day.png
    """
    from rorg.cli.context import Context
    from rorg.cli.output import check_form, print_rows
    from rorg.manifest.traces import read_trace
    from rorg.manifest.workloads import read_workload
    from rorg.model.workload import Workload
    from rorg.sim.report import COLUMNS, WIDE, as_json, rows
    from rorg.sim.simulate import simulate

    check_form(output)
    context = Context(None, None, directory, local=True)
    catalog = context.catalog()
    asked = read_trace(trace, {*catalog.services, *catalog.groups})
    programs = read_workload(workload) if workload else Workload("manifests")
    learned = _learned(learn)
    if compare or sweep:
        from rorg.cli.trying import Trial, try_out
        from rorg.sim.variants import Tree

        tree = Tree(context.root, catalog, context.engine_name, context.robot)
        try_out(Trial(tree, asked, programs, seed, learned), compare, sweep, output, csv, plot)
        return
    results = [
        simulate(catalog, asked, programs, seed, name=name, all_on=all_on, every=every, learned=learned)
        for name, all_on in (("all-on", True), ("rorg", False))
    ]
    if csv:
        _write(results, asked, csv)
    if plot:
        from rorg.sim.plots import draw

        draw(results, asked, plot, f"simulated, seed {seed}; synthetic weights: {programs.name}")
    full = {"trace": asked.name, "workload": programs.name, "seed": seed, "runs": as_json(results)}
    print_rows(rows(results), output, COLUMNS, WIDE, full)


def _learned(path: Path | None) -> Learned:
    from rorg.core.learning import learn
    from rorg.manifest.traces import read_trace
    from rorg.model.learned import Learned

    return learn(read_trace(path).events) if path else Learned()


def _write(results: Sequence[RunResult], trace: Trace, path: Path) -> None:
    """The time series."""
    import csv

    from rorg.errors import Invalid
    from rorg.sim.report import SERIES, series

    try:
        with path.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(SERIES)
            writer.writerows(series(results, trace))
    except OSError as error:
        raise Invalid(f"write {path}", error.strerror or str(error), "another file by --csv") from error
