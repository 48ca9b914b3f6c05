"""Figures of traces and of their runs: values for programs, rows for tables, time series."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from math import ceil
from statistics import median
from typing import Any

from rorg.model.trace import Trace
from rorg.model.units import format_memory, format_seconds
from rorg.tools.sim.results import Response, RunResult

COLUMNS = ("run", "cpu", "memory", "peak", "ready", "95%", "never", "violations")
"""Columns of a table with a row for each run."""
WIDE = ("calls",)
SHORT = "cpu_short"
"""Another column if the machine's cores are known."""
SERIES = ("run", "at", "state", "cpu", "memory", "active", "paused")
"""Columns of a time series with a row for each sample."""


def summary(result: RunResult, against: RunResult | None = None) -> dict[str, Any]:
    """Cores, bytes and seconds. `reduction`: the fraction that this run saves compared with `against`."""
    return {
        "run": result.name,
        "duration": result.duration,
        "cpu": result.cpu,
        "memory": result.memory,
        "peak_memory": result.peak_memory,
        "reduction": None if against is None else reduction(result, against),
        "responses": {
            "all": _times(result.responses),
            **{state: _times(those) for state, those in by_state(result.responses).items()},
        },
        "violations": dict(sorted(Counter(v.code for v in result.violations).items())),
        "calls": dict(result.actions or {}),
        **({} if result.shortage is None else {SHORT: asdict(result.shortage)}),
    }


def reduction(result: RunResult, against: RunResult) -> dict[str, float]:
    """The fractions of CPU and memory that are saved."""
    return {
        "cpu": 1 - result.cpu / against.cpu if against.cpu else 0.0,
        "memory": 1 - result.memory / against.memory if against.memory else 0.0,
    }


def by_state(responses: Sequence[Response]) -> dict[str, list[Response]]:
    """Responses by the state that was entered, or by the id of a request outside of any state."""
    responses_by_state: dict[str, list[Response]] = {}
    for one in responses:
        responses_by_state.setdefault(one.state or one.id, []).append(one)
    return dict(sorted(responses_by_state.items()))


def _times(responses: Sequence[Response]) -> dict[str, Any]:
    """Response times in seconds; `never` counts requests that were released before they were ready."""
    seconds = sorted(r.seconds for r in responses if r.seconds is not None)
    return {
        "count": len(responses),
        "never": len(responses) - len(seconds),
        "median": median(seconds) if seconds else None,
        "p95": seconds[ceil(0.95 * len(seconds)) - 1] if seconds else None,
        "most": seconds[-1] if seconds else None,
    }


def as_json(results: Sequence[RunResult]) -> list[dict[str, Any]]:
    """Everything but the samples; each run is compared with the first one."""
    return [
        {
            **summary(one, results[0] if one is not results[0] else None),
            "requests": [asdict(response) for response in one.responses],
            "violated": [asdict(violation) for violation in one.violations],
        }
        for one in results
    ]


def rows(results: Sequence[RunResult]) -> list[dict[str, str]]:
    """Rows for a table; each run is compared with the first one."""
    return [_row(summary(one, results[0] if one is not results[0] else None)) for one in results]


def _row(summary: Mapping[str, Any]) -> dict[str, str]:
    less, times = summary["reduction"] or {"cpu": None, "memory": None}, summary["responses"]["all"]
    return {
        "run": summary["run"],
        "cpu": f"{summary['cpu']:.2f}{_percent(less['cpu'])}",
        "memory": f"{format_memory(round(summary['memory']))}{_percent(less['memory'])}",
        "peak": format_memory(summary["peak_memory"]),
        "ready": _seconds(times["median"]),
        "95%": _seconds(times["p95"]),
        "never": f"{times['never']} of {times['count']}",
        "violations": ", ".join(f"{n} {code}" for code, n in summary["violations"].items()) or "-",
        "calls": ", ".join(f"{n} {verb}" for verb, n in summary["calls"].items()) or "-",
        **({SHORT: _short(summary[SHORT])} if SHORT in summary else {}),
    }


def _short(shortage: Mapping[str, float]) -> str:
    """For how long programs wanted more than all cores, and how many core seconds they lacked."""
    return f"{format_seconds(shortage['seconds'])}, {shortage['core_seconds']:.1f} core seconds"


def _percent(part: float | None) -> str:
    return "" if part is None else f" ({-100 * part:+.1f} %)"


def _seconds(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f} s"


def series(results: Sequence[RunResult], trace: Trace) -> Iterator[tuple[str | int | float, ...]]:
    """Rows of SERIES: cores since the last sample, bytes, and the number of running and paused services."""
    for one in results:
        states = trace.states()
        for sample in one.samples:
            while states and states[0][1] < sample.at:
                states.pop(0)
            state = states[0][3] if states and states[0][0] <= sample.at else ""
            yield one.name, sample.at, state, sample.cpu, sample.memory, len(sample.active), len(sample.paused)


@dataclass(frozen=True, slots=True)
class Activity:
    """A state of a behaviour, or a request outside of any state, over a whole trace."""

    kind: str
    """state or request."""
    by: str
    """The behaviour, or the requester."""
    name: str
    """The state, or the request's id."""
    lengths: tuple[float, ...]
    """Seconds of each occurrence, in order. Requesting other services under the same id is a new occurrence."""

    @property
    def total(self) -> float:
        return sum(self.lengths)

    @property
    def mean(self) -> float:
        return self.total / len(self.lengths)

    def as_json(self) -> dict[str, Any]:
        return {
            "kind": self.kind,
            "by": self.by,
            "name": self.name,
            "times": len(self.lengths),
            "total": round(self.total, 3),
            "mean": round(self.mean, 3),
            "min": round(min(self.lengths), 3),
            "max": round(max(self.lengths), 3),
        }


def activities(trace: Trace) -> list[Activity]:
    """All activities of a trace, in order of their first occurrence."""
    lengths = dict[tuple[str, str, str], list[float]]()
    under_way = dict[tuple[str, str], tuple[float, list[float]]]()
    for event in trace.events:
        request = event.requester, event.id
        if request in under_way:
            since, of = under_way.pop(request)
            of.append(event.at - since)
        if event.state or event.services:
            what = ("state", event.requester, event.state) if event.state else ("request", *request)
            under_way[request] = event.at, lengths.setdefault(what, [])
    for since, of in under_way.values():
        of.append(trace.duration - since)
    return [Activity(*what, tuple(of)) for what, of in lengths.items()]
