"""rorg emulate"""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rorg.cli.context import Context
from rorg.cli.kinds import FILE, numbers
from rorg.cli.options import Directory, EngineName, Output
from rorg.cli.output import as_json, disk_errors, note, print_rows, table
from rorg.errors import Invalid, Refused
from rorg.model.units import format_memory

if TYPE_CHECKING:
    from rorg.model.catalog import Catalog
    from rorg.model.trace import Trace
    from rorg.tools.sim.emulate import Experiment, Share
    from rorg.tools.sim.emulation import Compared, Emulation
    from rorg.tools.sim.player import EmulatedRun

COLUMNS = (
    "run",
    "pair",
    "cpu",
    "memory",
    "full_cpu",
    "full_memory",
    "rorg_cpu",
    "rorg_memory",
    "agreement",
    "sets",
    "replayed",
    "replayed_sets",
)
SHORTEST = 2.0
"""Shortest run, in seconds: a sample takes one."""

Scale = Annotated[
    float | None,
    typer.Option(
        help="Factor on the declared CPU and memory. Default: everything on takes a quarter of the machine.",
        metavar="F",
        parser=numbers(0.001, 1),
    ),
]
Save = Annotated[
    Path | None, typer.Option(help="Write all measurements to this file, as JSON, after each run.", click_type=FILE)
]
Plot = Annotated[
    Path | None,
    typer.Option(help="Plot CPU, memory and activity of the first pair to a .svg, .png or .html.", click_type=FILE),
]


def command(
    trace: Annotated[Path, typer.Argument(help="File of a Trace: the requests to replay.", click_type=FILE)],
    directory: Directory = None,
    *,
    compress: Annotated[
        float, typer.Option(help="Divide the times of the trace by this.", parser=numbers(1, 1000))
    ] = 6.0,
    pairs: Annotated[int, typer.Option(help="How often to run everything-on and rorg in turns.", min=1, max=100)] = 3,
    scale: Scale = None,
    engine: EngineName = None,
    save: Save = None,
    plot: Plot = None,
    output: Output = "table",
) -> None:
    """Replay a trace on a real engine with stand-in programs, with everything on and with rorg in turns. Leave
    nothing behind. Needs a machine that does nothing else: if other programs use more than 10% of its CPU, a stand-in
    gets less than 95% of its own, or a request never becomes ready, it reports an error instead of figures.

    Example: rorg emulate docs/evaluation/hour.yaml manifests --compress 6 --pairs 3
    """

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    experiment = _experiment(trace, directory, compress, scale, engine)
    _check_files(save, plot)
    signal.signal(signal.SIGTERM, interrupt)
    signal.signal(signal.SIGINT, interrupt)
    try:
        emulation = _measured(experiment, compress, pairs, save)
        if plot:
            _draw(emulation, experiment, plot)
        _print(emulation, output)
    except KeyboardInterrupt:
        note("interrupted")
        sys.exit(130)


def _experiment(
    path: Path, directory: Path | None, compress: float, scale: float | None, engine: str | None
) -> Experiment:
    """The experiment to run. Raises Invalid for mistakes."""
    from rorg.cli.demo.robot import TRITONBOT
    from rorg.manifest.load import load_or_raise
    from rorg.manifest.traces import read_trace
    from rorg.tools.sim.emulate import PROGRAM, Experiment

    context = Context(None, engine, directory, local=True, own=True)
    catalog = context.catalog()
    played = read_trace(path, {*catalog.services, *catalog.groups}).compressed(compress)
    if played.duration < SHORTEST:
        why = f"it takes {played.duration:g} s when compressed, less than {SHORTEST:g} s"
        raise Invalid(f"emulate {path}", why, "a smaller --compress")
    images = load_or_raise(TRITONBOT / "manifests").images
    return Experiment(
        root=context.root,
        robot=context.robot,
        catalog=catalog,
        images={name: images[name] for name in (PROGRAM, *images[PROGRAM].bases)},
        engine=context.engine_name,
        trace=played,
        share=_share(catalog, played, scale),
    )


def _share(catalog: Catalog, trace: Trace, scale: float | None) -> Share:
    from rorg.host.load import machine
    from rorg.tools.sim.emulate import Share, share_of
    from rorg.tools.sim.simulate import all_on_services

    if scale is not None:
        return Share(scale, scale)
    now = machine()
    return share_of(catalog, all_on_services(catalog, trace), now["cores"], now["memory_total"])


def _measured(experiment: Experiment, compress: float, pairs: int, save: Path | None) -> Emulation:
    """Measures all runs, and saves what is known after each of them."""
    from contextlib import closing

    from rorg.host.load import machine
    from rorg.tools.sim.emulate import emulate
    from rorg.tools.sim.emulation import Emulation
    from rorg.tools.sim.emulation import as_json as plain

    now = machine()
    emulation = Emulation(
        trace=experiment.trace.name,
        compress=compress,
        engine=experiment.engine,
        share=experiment.share,
        machine={"cores": now["cores"], "memory": now["memory_total"]},
        runs=(),
    )
    with closing(emulate(experiment, pairs, note)) as runs:
        for run in runs:
            emulation = emulation.with_run(_compared(experiment, run))
            if save:
                _save(save, as_json(plain(emulation), 1) + "\n")
            _check(emulation, save)
            note(_told(emulation))
    return emulation


def _check(emulation: Emulation, save: Path | None) -> None:
    """Raises Refused if the last run is not valid."""
    run = emulation.runs[-1].run
    if run.flaws:
        if save:
            note(f"{save} has the measurements, marked as invalid")
        what = f"report the run {run.result.name} of pair {(len(emulation.runs) + 1) // 2}"
        raise Refused(what, ", and ".join(flaw.why for flaw in run.flaws), run.flaws[0].remedy)


def _compared(experiment: Experiment, run: EmulatedRun) -> Compared:
    from rorg.tools.sim.emulate import ALL_ON
    from rorg.tools.sim.emulation import Compared, agreement, calibrated, replayed, simulated

    catalog, all_on = experiment.stand_ins(), run.result.name == ALL_ON
    drawn, same = (
        simulated(catalog, experiment.trace, run, workload, all_on) for workload in (calibrated(run), replayed(run))
    )
    return Compared(run, agreement(drawn, run.result), agreement(same, run.result), same)


def _check_files(save: Path | None, plot: Path | None) -> None:
    """Raises Invalid for files that cannot be written. Their content stays until there is something new."""
    if save:
        _save(save, "", "a")
    if plot:
        from rorg.plots.figure import check_drawing

        check_drawing(plot)


def _draw(emulation: Emulation, experiment: Experiment, path: Path) -> None:
    from rorg.tools.sim.plots import draw

    results = [one.run.result for one in emulation.runs[:2]]
    said = (
        f"measured on the {emulation.engine} engine with stand-ins, which use {emulation.share.cpu:.1%} of the CPU and "
    )
    draw(results, experiment.trace, path, said + f"{emulation.share.memory:.1%} of the memory of the manifests")


def _save(path: Path, text: str, mode: str = "w") -> None:
    with disk_errors(f"write {path}", "another file for --save"), path.open(mode, encoding="utf-8") as file:
        file.write(text)


def _told(emulation: Emulation) -> str:
    """The last run in one line."""
    row = _rows(emulation)[-1]
    return f"{row['run']}: {row['cpu']} cores, {row['memory']}; rorg itself {row['rorg_cpu']} cores"


def _rows(emulation: Emulation) -> list[dict[str, str]]:
    rows = []
    for number, one in enumerate(emulation.runs):
        run, share = one.run, emulation.share
        rows.append(
            {
                "run": run.result.name,
                "pair": str(number // 2 + 1),
                "cpu": f"{run.result.cpu:.3f}",
                "memory": format_memory(run.result.memory),
                "full_cpu": f"{run.result.cpu / share.cpu:.2f}",
                "full_memory": format_memory(run.result.memory / share.memory),
                "rorg_cpu": f"{run.own_cpu:.3f}",
                "rorg_memory": format_memory(run.own_memory),
                "agreement": f"{one.drawn.services:.2%}",
                "sets": f"{one.drawn.sets:.2%}",
                "replayed": f"{one.replayed.services:.2%}",
                "replayed_sets": f"{one.replayed.sets:.2%}",
            }
        )
    return rows


def _print(emulation: Emulation, output: str) -> None:
    from rorg.tools.sim.emulation import as_json

    rows, lines = _rows(emulation), list[str]()
    for what, of in (("CPU", "cpu"), ("memory", "memory")):
        one = emulation.reductions[of]
        spread = (
            "one pair"
            if one.deviation is None
            else f"from {-one.most:+.1%} to {-one.least:+.1%}, standard deviation {one.deviation:.1%}"
        )
        lines.append(f"{what}: {-one.mean:+.1%} with rorg ({spread})")
    share = emulation.share
    lines.append(f"stand-ins use {share.cpu:.1%} of the CPU and {share.memory:.1%} of the memory that is declared")
    print_rows(rows, output, COLUMNS, full=as_json(emulation), text="\n".join([table(rows, COLUMNS), "", *lines]))
