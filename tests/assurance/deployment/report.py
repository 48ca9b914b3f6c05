"""Writes docs/evaluation/deployment.md, its plot, and a line in docs/evaluation.md from the record of a week.
`python -m deployment.report` does it again without playing."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from statistics import median, quantiles
from typing import TYPE_CHECKING, Any

from common import ROOT
from deployment.figures import BOUND, ENGINE, NO_REASON, UNTRIED, UPDATES, Figures, Start
from deployment.tour_guide import tour_guide
from deployment.week import DAY, Kind

from rorg.plots.figure import save
from rorg.plots.states import LOOKS, REQUEST

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURES, OVERVIEW = ROOT / "docs/evaluation/deployment.json", ROOT / "docs/evaluation.md"
PAGE = FIGURES.with_suffix(".md")
BEGIN, END = "<!-- begin: deployment headline -->", "<!-- end: deployment headline -->"
TEXT = Path(__file__).parent / "page.md"
"""The page without its figures."""
QUIET = (Kind.ASKED, Kind.NIGHT, Kind.RORG_STARTED, Kind.ENGINE_BACK, Kind.REMOTE_BACK)
LANES = {
    "updates": UPDATES,
    "reverts": (Kind.REVERT,),
    "kills of containers": (Kind.KILL,),
    "kills of rorg": (Kind.RORG_KILLED,),
    "engine restarts": ENGINE,
    "engine cut off": (Kind.ENGINE_CUT, Kind.ENGINE_SILENT),
    "repository cut off": (Kind.REMOTE_CUT,),
}
PART = 10.0
"""Seconds of a point of the plot."""


def read(path: Path = FIGURES) -> Figures:
    return Figures(json.loads(path.read_text()), tour_guide())


def headline(figures: Figures) -> str:
    """The result in one sentence."""
    fates, updates = figures.fates(), sum(e.kind in UPDATES for e in figures.events)
    faults = sum(e.kind not in (*QUIET, *UPDATES, Kind.REVERT) for e in figures.events)
    counted, up = (sum(values) for values in zip(*figures.availability().values(), strict=True))
    good = sum(f.outcome in ("taken back", "refused") for f in fates)
    tried = sum(f.outcome != UNTRIED for f in fates)
    return (
        f"{updates} updates, {len(fates)} of them bad, and {faults} faults: services answered for {up / counted:.2%} "
        f"of the time in which they were asked for. rorg took back or refused {good} of the {tried} bad updates that "
        f"came into use before they were reverted. {_number(len(wrong(figures)), 'wrong state')}, "
        f"{_number(len(needless(figures)), 'needless restart').lower()}."
    )


def _number(count: int, what: str) -> str:
    return f"{count or 'no'} {what}{'' if count == 1 else 's'}".capitalize()


def needless(figures: Figures) -> list[Start]:
    return [start for start in figures.starts() if start.cause in NO_REASON]


def wrong(figures: Figures) -> list[str]:
    """What differed for too long, and what still differed at the end of a night."""
    lasting = [
        f"{name} for {seconds:.0f} s from {at:.0f} s: {text}" for at, name, seconds, text in _rows(figures, "wrong")
    ]
    return lasting + [
        f"{name} at {at:.0f} s: {text}" for at, _, left in _rows(figures, "nights") for name, text in left.items()
    ]


def _rows(figures: Figures, name: str) -> list[list[Any]]:
    return figures.record[name]


# -- tables ----------------------------------------------------------------------------------------------------


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines)


def events(figures: Figures) -> str:
    kinds = Counter((e.kind, str(e.bad)) for e in figures.events if e.kind not in QUIET)
    missed = Counter((e.kind, str(e.bad)) for e in figures.events if e.outcome)
    rows = [
        [kind + (f": {bad}" if bad else ""), kinds[kind, bad], missed[kind, bad] or ""] for kind, bad in sorted(kinds)
    ]
    return table(("event", "number", "without effect"), rows)


def requests(figures: Figures) -> str:
    rows = []
    for state in sorted({request.state for request in figures.requests}):
        those = [r for r in figures.requests if r.state == state]
        outcomes, ready = Counter(r.outcome for r in those), sorted(r.ready for r in those if r.ready is not None)
        times = [f"{value:.1f} s" for value in (*_spread(ready), ready[-1])] if ready else [""] * 3
        rows.append([state, len(those), *(outcomes[o] for o in ("in time", "late", "withdrawn")), *times])
    return table(
        ("state", "requests", f"ready within {BOUND:g} s", "late", "ended before", "median", "95 %", "longest"), rows
    )


def _spread(values: Sequence[float]) -> tuple[float, float]:
    return (median(values), quantiles(values, n=20, method="inclusive")[-1]) if len(values) > 1 else (*values, *values)


def services(figures: Figures) -> str:
    rows = []
    for name, (counted, up) in figures.availability().items():
        mine = [down for down in figures.downs if down.service == name]
        longest = max((down.end - down.begin for down in mine), default=0.0)
        share = f"{up / counted:.2%}" if counted else "never asked for"
        rows.append([name, f"{counted:.0f} s", share, len(mine), f"{longest:.1f} s" if mine else ""])
    return table(("service", "asked for", "answered", "times down", "longest"), rows)


def downtime(figures: Figures) -> str:
    rows = []
    for cause in {down.cause for down in figures.downs}:
        those = [down.end - down.begin for down in figures.downs if down.cause == cause]
        rows.append([cause, len(those), f"{sum(those):.0f} s", f"{median(those):.1f} s", f"{max(those):.1f} s"])
    return table(("cause", "times", "in all", "median", "longest"), sorted(rows, key=lambda r: -float(r[2][:-2])))


def bad_updates(figures: Figures) -> str:
    fates = figures.fates()
    kinds = Counter((str(f.bad), f.outcome) for f in fates)
    rows = []
    for (bad, outcome), count in sorted(kinds.items()):
        down = [f.down for f in fates if (f.bad, f.outcome) == (bad, outcome)]
        rows.append([bad, outcome, count, sum(not seconds for seconds in down), f"{max(down):.1f} s"])
    return table(
        ("bad update", "what became of it", "number", "no time without an answer", "longest time without"), rows
    )


def restarts(figures: Figures) -> str:
    kinds = Counter((start.cause, start.what) for start in figures.starts())
    return table(
        ("cause", "restarts of a container", "containers created again"),
        [[cause, kinds[cause, "start"], kinds[cause, "create"]] for cause in sorted({cause for cause, _ in kinds})],
    )


def nights(figures: Figures) -> str:
    rows = [[n, f"{seconds:.1f} s", len(left)] for n, (_, seconds, left) in enumerate(_rows(figures, "nights"), 1)]
    return table(("night", "as asked for after", "services that were not"), rows)


def growth(figures: Figures) -> str:
    samples, rows = _rows(figures, "samples"), []
    for day in range(int(samples[-1][0] // DAY) + 1):
        those = [s for s in samples if s[0] // DAY == day]
        last, memory, load = those[-1], [s[1] for s in those], [s[6] for s in those]
        use = f"{median(memory):.0f}, {max(memory):.0f} MB"
        rows.append([day + 1, use, f"{last[2]:.1f} MB", f"{last[3]:.1f} MB", last[4], last[5], f"{median(load):.0f}"])
    return table(("day", "rorg: median, most", "journal", "state directory", "containers", "images", "load"), rows)


def effect(figures: Figures) -> str:
    seconds = sorted(figures.took_effect())
    middle, most = _spread(seconds)
    return (
        f"Of the good updates, {len(seconds)} were of services that ran and went on being asked for: these answered in "
        f"their new edition after {middle:.1f} s (median; 95 %: {most:.1f} s)."
    )


def listed(lines: Sequence[str]) -> str:
    return "\n".join(f"- {line}" for line in lines) or "None."


def page(figures: Figures) -> str:
    """The text of the page."""
    unjust = [f"{name} at {at:.0f} s: {text}" for at, name, text in figures.unjust()]
    parts = {"headline": headline(figures), "effect": effect(figures), "wrong": listed(wrong(figures))}
    parts |= {
        "unjust": listed(unjust),
        "needless": listed([f"{s.what} of {s.service} at {s.at:.0f} s" for s in needless(figures)]),
    }
    makers = (events, requests, services, downtime, bad_updates, restarts, nights, growth)
    load = median(sample[6] for sample in _rows(figures, "samples"))
    parts |= {"cores": figures.record["cores"], "load": f"{load:.0f}"}
    parts |= {maker.__name__: maker(figures) for maker in makers}
    return TEXT.read_text().format_map(parts)


# -- the plot --------------------------------------------------------------------------------------------------


def draw(figures: Figures) -> Figure:
    """Events and availability over the week."""
    from matplotlib.figure import Figure

    made = Figure(figsize=(10, 6), layout="constrained")
    availability, lanes, memory = made.subplots(3, 1, sharex=True, height_ratios=(3, 3, 2))
    minutes = [(at / 60, 100 * part) for at, part in figures.parts(PART)]
    availability.step(*zip(*minutes, strict=True), where="pre", color=LOOKS["ready"].bar, linewidth=1.0)
    availability.set_ylabel("services that answer (%)")
    for row, kinds in enumerate(LANES.values()):
        for bad, colour in ((False, REQUEST), (True, LOOKS["failing"].bar)):
            at = [e.at / 60 for e in figures.events if e.kind in kinds and bool(e.bad) == bad]
            lanes.vlines(at, row + 0.1, row + 0.9, colors=colour, linewidth=1.0)
    lanes.set_yticks([row + 0.5 for row in range(len(LANES))], list(LANES))
    lanes.set_ylim(len(LANES), 0)
    lanes.tick_params(left=False)
    samples = figures.record["samples"]
    memory.plot([s[0] / 60 for s in samples], [s[1] for s in samples], color="#0550ae", linewidth=1.0)
    memory.set_ylim(bottom=0)
    memory.set_ylabel("memory of rorg (MB)")
    memory.set_xlabel("minutes; dark red: bad updates and their reverts")
    for axes in (availability, lanes, memory):
        axes.grid(axis="x" if axes is lanes else "both", alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_xlim(0, figures.end / 60)
    made.suptitle("A week of the tour guide", x=0.01, ha="left", fontweight="bold")
    return made


def overview(text: str, figures: Figures) -> str:
    """docs/evaluation.md with the result."""
    before, _, rest = text.partition(BEGIN)
    return f"{before}{BEGIN}\n\n{headline(figures)}\n\n{END}{rest.partition(END)[2]}"


def write(path: Path = FIGURES) -> None:
    """`path`: of the record; page and plot are written beside it."""
    figures = read(path)
    path.with_suffix(".md").write_text(page(figures))
    save(lambda: draw(figures), path.with_suffix(".svg"))
    if path == FIGURES:
        OVERVIEW.write_text(overview(OVERVIEW.read_text(), figures))


if __name__ == "__main__":
    write()
