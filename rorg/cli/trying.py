"""What `rorg simulate --compare` and `--sweep` do: one trace on several variants of a robot, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rorg.cli.output import print_rows

if TYPE_CHECKING:
    from rorg.model.learned import Learned
    from rorg.model.trace import Trace
    from rorg.model.workload import Workload
    from rorg.sim.tradeoff import Tried
    from rorg.sim.variants import Tree, Variant

ALL_ON, DECLARED = "all-on", "as-declared"
"""What variants are compared with."""
SHOWN = ("run", "cpu", "memory", "response", "median", "p95", "violations", "calls", "efficient")
ALSO = ("peak_memory", "requests", "unready")


@dataclass(frozen=True)
class Trial:
    """What variants are tried with."""

    tree: Tree
    trace: Trace
    workload: Workload
    seed: int
    learned: Learned
    """What is known of requests when it begins, for services that are prewarmed."""

    def compare(self, texts: Sequence[str]) -> list[Tried]:
        """Variants, below everything on and the tree as it is. Raises Invalid."""
        from rorg.sim.variants import Variant, variant

        given = [variant(text, self.tree) for text in texts]
        return self._tried([Variant(name, self.tree.catalog) for name in (ALL_ON, DECLARED)] + given)

    def sweep(self, texts: Sequence[str]) -> list[Tried]:
        """All combinations, below the tree as it is. Raises Invalid."""
        from rorg.sim.variants import Variant, sweep

        return self._tried([Variant(DECLARED, self.tree.catalog), *sweep(texts, self.tree)])

    def _tried(self, variants: Sequence[Variant]) -> list[Tried]:
        from rorg.sim.simulate import simulate
        from rorg.sim.tradeoff import tried

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
                learned=self.learned,
            )
            for one in variants
        ]
        return tried(variants, results)

    def _check(self, variant: Variant) -> None:
        """Raises Invalid for a tree that does not have what the trace names."""
        from rorg.errors import Invalid

        known = {*variant.catalog.services, *variant.catalog.groups}
        named = {name for event in self.trace.events for name in (event.requester, *event.services)}
        missing = sorted(named - known)
        if missing:
            why = f"the trace {self.trace.name} names {missing[0]}, which it does not declare"
            raise Invalid(f"try '{variant.name}'", why, "a tree with all that the trace names")


def try_out(
    trial: Trial, compare: Sequence[str], sweep: Sequence[str], output: str, csv: Path | None, plot: Path | None
) -> None:
    """What the options say. Raises Invalid."""
    from rorg.errors import Invalid

    if compare and sweep:
        raise Invalid("try variants", "--compare and --sweep each name their own", "one of them")
    found = trial.compare(compare) if compare else trial.sweep(sweep)
    if csv:
        write_csv(found, csv)
    if plot:
        draw(trial, found, plot)
    show(found, output)


def draw(trial: Trial, found: Sequence[Tried], file: Path) -> None:
    """Raises Invalid."""
    from rorg.sim.plots import draw_sweep, save

    note = f"Simulated, seed {trial.seed}; synthetic weights: {trial.workload.name}."
    save(lambda: draw_sweep(found, trial.trace.name, note), file)


def show(found: Sequence[Tried], output: str) -> None:
    """Response times (in the mean, the median and the 95th percentile) are of the requests that take any time with at
    least one of the variants; efficient: none of the others beats it in CPU, memory and mean response time."""
    from rorg.model.units import format_memory

    full = [one.as_json() for one in found]
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
    print_rows(rows, output, SHOWN, ALSO, full=full)


def write_csv(found: Sequence[Tried], file: Path) -> None:
    """A line a variant, each setting in a column of its own. Raises Invalid."""
    import csv

    from rorg.errors import Invalid

    rows = [{**one.as_json(), **one.variant.settings} for one in found]
    settings = dict.fromkeys(key for one in found for key in one.variant.settings)
    columns = ["run", *settings, *(key for key in found[0].as_json() if key not in ("run", "settings"))]
    try:
        with file.open("w", newline="") as to:
            writer = csv.DictWriter(to, columns, extrasaction="ignore", lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    except OSError as error:
        raise Invalid(f"write {file}", error.strerror or str(error), "another file") from error
