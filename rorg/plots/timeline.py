"""The robot over time: the requests, a lane for each service, and what the machine used, on one axis. As figure 4 of
the paper, for any robot."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from rorg.model.units import parse_time
from rorg.plots.states import LOOKS, OF_STATE, REQUEST, Look
from rorg.plots.times import GIB, MACHINE, QUIET, Bar, Use, axis_of_time, day_of, days

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROW = 0.22
"""Inches."""
NARROW = 0.0008
"""Part of the width that a bar has at least."""


class Story(NamedTuple):
    """What happened from `begin` to `end`, in seconds since the epoch."""

    begin: float
    end: float
    requests: Mapping[str, Sequence[Bar]]
    """Requests (service and requester) -> when."""
    services: Mapping[str, Sequence[Bar]]
    machine: Use | None


def bars_of_spans(spans: Iterable[Mapping[str, Any]], end: float) -> list[Bar]:
    """The spans of a service, as the API tells them."""
    return [
        Bar(
            parse_time(span["begin"]),
            parse_time(span["end"]) if span["end"] else end,
            "failing" if span.get("failed") else OF_STATE[span["state"]],
        )
        for span in spans
        if span["state"] in OF_STATE
    ]


def bars_of_requests(requests: Iterable[Mapping[str, Any]], end: float) -> dict[str, list[Bar]]:
    """The requests of a time, as the API tells them, by what was requested and who did: a record without services is a
    release."""
    rows: dict[str, list[Bar]] = {}
    open_: dict[tuple[str, str], tuple[str, float]] = {}
    for record in requests:
        key, at = (record["requester"], record["id"]), parse_time(record["at"])
        if key in open_:
            row, begin = open_.pop(key)
            rows[row].append(Bar(begin, at, "request"))
        if record["services"]:
            row = f"{', '.join(record['services'])} ({record['requester']})"
            rows.setdefault(row, [])
            open_[key] = row, at
    for row, begin in open_.values():
        rows[row].append(Bar(begin, end, "request"))
    return rows


def draw_timeline(story: Story, title: str) -> Figure:
    """The figure."""
    from matplotlib.figure import Figure

    lanes = max(len(story.services), 1), max(len(story.requests), 1)
    heights = [ROW * lanes[1] + 0.2, ROW * lanes[0] + 0.2, *([1.0, 1.0] if story.machine else [])]
    figure = Figure(figsize=(10, sum(heights) + 1.4), layout="constrained")
    panels = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    _lanes(panels[0], story.requests, story)
    _lanes(panels[1], story.services, story)
    panels[0].set_title("requests", loc="left", fontsize=9)
    panels[1].set_title("services", loc="left", fontsize=9)
    if story.machine:
        _line(panels[2], *story.machine.line("cores"), "CPU (cores)")
        _line(panels[3], *story.machine.line("memory", GIB), "memory (GiB)")
    axis_of_time(panels[-1], story.begin, story.end)
    used = {bar.look for bars in story.services.values() for bar in bars}
    if used:
        handles = [_patch(look) for look in LOOKS if look in used]
        figure.legend(handles=handles, loc="outside lower left", ncols=6, frameon=False)
    figure.suptitle(f"{title}, {day_of(story.begin, story.end)}", x=0.01, ha="left", fontweight="bold")
    return figure


def _patch(look: str) -> Any:
    from matplotlib.patches import Patch

    shown = LOOKS[look]
    return Patch(facecolor=shown.bar, edgecolor=shown.edge, hatch=shown.hatch, label=look)


def _lanes(axes: Axes, rows: Mapping[str, Sequence[Bar]], story: Story) -> None:
    """One row for each name, the first at the top; all bars of a row that look alike are one object."""
    least = NARROW * (story.end - story.begin)
    for row, bars in enumerate(rows.values()):
        for look in dict.fromkeys(bar.look for bar in bars):
            shown = LOOKS.get(look, Look(REQUEST, "", REQUEST, "", ""))
            ranges = [
                (days(max(bar.begin, story.begin)), days(max(bar.end - max(bar.begin, story.begin), least)))
                for bar in bars
                if bar.look == look and bar.end > story.begin and bar.begin < story.end
            ]
            axes.broken_barh(ranges, (row + 0.14, 0.72), facecolors=shown.bar, edgecolors=shown.edge, hatch=shown.hatch)
    axes.set_ylim(max(len(rows), 1), 0)
    axes.set_yticks([row + 0.5 for row in range(len(rows))], list(rows))
    axes.tick_params(axis="y", length=0)
    axes.spines[["top", "right", "left"]].set_visible(False)
    if not rows:
        axes.text(0.5, 0.5, "nothing on record", transform=axes.transAxes, ha="center", va="center", color=QUIET)


def _line(axes: Axes, times: Sequence[float], values: Sequence[float], label: str) -> None:
    axes.plot(times, values, color=MACHINE, linewidth=1.0)
    axes.set_ylim(bottom=0)
    axes.set_ylabel(label)
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)
