"""What the pictures over time share: the axis, bars, and what the machine and its services used."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, NamedTuple

from rorg.model.units import parse_time

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FULL = "0000-01-01T00:00:00Z"
GIB = 1 << 30
MACHINE = "#1f2328"
QUIET = "#59636e"


class Bar(NamedTuple):
    """A time on the axis, in seconds since the epoch."""

    begin: float
    end: float
    look: str
    """One of LOOKS, or `request`."""


class Use(NamedTuple):
    """What something used over time: the mean of each slot."""

    slots: Sequence[tuple[float, float]]
    """(begin, end) in seconds since the epoch."""
    cores: Sequence[float]
    memory: Sequence[float]
    """Bytes."""

    def line(self, field: str, unit: float = 1.0) -> tuple[list[float], list[float]]:
        """The times and values to draw: each slot as wide as it is, also if it is the only one."""
        times = [days(at) for slot in self.slots for at in slot]
        return times, [value / unit for value in getattr(self, field) for _ in range(2)]


def uses(slots: Iterable[Mapping[str, Any]]) -> dict[str, Use]:
    """By service, "" for the machine: slots of the API (SlotView), in order of time."""
    rows: dict[str, list[Mapping[str, Any]]] = {}
    for slot in slots:
        rows.setdefault(str(slot["service"]), []).append(slot)
    return {
        name: Use([_times(one) for one in own], [one["cores"] for one in own], [one["memory"] for one in own])
        for name, own in rows.items()
    }


def _times(slot: Mapping[str, Any]) -> tuple[float, float]:
    at = str(slot["at"])
    begin = parse_time(at + FULL[len(at) :])
    return begin, begin + float(slot["seconds"])


def days(seconds: float) -> float:
    """A time as matplotlib counts it."""
    return seconds / 86400


def axis_of_time(axes: Axes, begin: float, end: float) -> None:
    """Labels the time in UTC, from `begin` to `end` in seconds since the epoch."""
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    locator = AutoDateLocator(minticks=4, maxticks=9)  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    axes.set_xlim(days(begin), days(end))
    axes.set_xlabel("time (UTC)")


def day_of(begin: float, end: float) -> str:
    """The dates of a time, for a title."""
    first, last = (f"{datetime.fromtimestamp(at, UTC):%Y-%m-%d}" for at in (begin, end))
    return first if first == last else f"{first} to {last}"
