"""CPU and memory over time: the services that used most, stacked, under the line of the whole machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rorg.plots.times import GIB, MACHINE, Use, axis_of_time, day_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST = 8
"""Services with an area of their own; the others share one."""
AREAS = ("#0550ae", "#fb8f44", "#116329", "#d4a72c", "#8250df", "#54aeff", "#a40e26", "#4ac26b", "#afb8c1")


def draw_usage(used: Mapping[str, Use], title: str, begin: float, end: float) -> Figure:
    """`used`: by service, "" for the machine."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 5.5), layout="constrained")
    cpu, memory = figure.subplots(2, 1, sharex=True)
    areas = stacked({name: use for name, use in used.items() if name})
    _panel(cpu, areas, used.get(""), "cores", 1.0)
    _panel(memory, areas, used.get(""), "memory", float(GIB))
    cpu.set_ylabel("CPU (cores)")
    memory.set_ylabel("memory (GiB)")
    axis_of_time(memory, begin, end)
    handles, labels = cpu.get_legend_handles_labels()
    if labels:
        figure.legend(handles, labels, loc="outside right upper", frameon=False)
    figure.suptitle(f"{title}, {day_of(begin, end)}", x=0.01, ha="left", fontweight="bold")
    return figure


def stacked(used: Mapping[str, Use]) -> dict[str, Use]:
    """The MOST services that used most CPU, and the others together, all with the same slots."""
    slots = sorted({slot for use in used.values() for slot in use.slots})
    filled = {name: _filled(use, slots) for name, use in used.items()}
    order = sorted(filled, key=lambda name: (-sum(filled[name].cores), name))
    areas = {name: filled[name] for name in order[:MOST]}
    if others := [filled[name] for name in order[MOST:]]:
        cores = [sum(values) for values in zip(*(use.cores for use in others), strict=True)]
        memory = [sum(values) for values in zip(*(use.memory for use in others), strict=True)]
        areas[f"{len(others)} others"] = Use(slots, cores, memory)
    return areas


def _filled(use: Use, slots: Sequence[tuple[float, float]]) -> Use:
    """With nothing in the slots in which it did not run."""
    known = {slot: (cores, memory) for slot, cores, memory in zip(*use, strict=True)}
    values = [known.get(slot, (0.0, 0.0)) for slot in slots]
    return Use(slots, [cores for cores, _ in values], [memory for _, memory in values])


def _panel(axes: Axes, areas: Mapping[str, Use], machine: Use | None, field: str, unit: float) -> None:
    lines = [use.line(field, unit) for use in areas.values()]
    if lines:
        colours: Any = AREAS[: len(areas)]
        axes.stackplot(lines[0][0], [values for _, values in lines], labels=list(areas), colors=colours)
    if machine is not None:
        axes.plot(*machine.line(field, unit), color=MACHINE, linewidth=1.2, label="the machine")
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)
