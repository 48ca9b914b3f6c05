"""The screen of `rorg top` as values: what services use, what keys change, and the resulting lines."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

from rorg.cli.output import COLOURS, cells
from rorg.cli.terminal import printable
from rorg.model.units import format_memory

if TYPE_CHECKING:
    from rorg_client.types import Usage

SORTS = {"c": "cpu", "m": "memory", "n": "service"}
DEEDS = {"l": "logs", "+": "request", "-": "release", "r": "restart"}
KEYS = (
    ("up, down, j, k", "choose a service"),
    ("c, m, n", "sort by CPU, memory, name"),
    ("/", "show only names with a text; Enter keeps it, Escape drops it"),
    ("l", "follow its log; Ctrl-C returns"),
    ("+", "request it"),
    ("-", "release the requests that name it, after asking"),
    ("r", "restart it, after asking"),
    ("q", "quit"),
    ("?", "this page"),
)
HINT = "? keys  q quit  c m n sort  / filter  + request  r restart"
COLUMNS = ("service", "state", "cpu", "memory", "priority", "why")
DROPPED = ("why", "priority", "state", "memory", "cpu")
"""Columns to drop on a narrow terminal, in this order. Names are always shown whole."""
LEAST_WHY = 12
"""Least characters of the last column, which is cut to fit; below that it is dropped."""


class Deed(NamedTuple):
    """What a person asks for: logs, request, release or restart of a service; or quit."""

    verb: str
    service: str = ""
    force: bool = False
    """The person has confirmed a release, or a restart although it affects a driver."""


@dataclass(frozen=True)
class View:
    """The selection and order that a person has chosen."""

    sort: str = "cpu"
    filter: str = ""
    typing: bool = False
    """Whether the filter is being typed."""
    selected: str = ""
    question: str = ""
    asked: Deed | None = None
    """The action to take if the answer is y."""
    message: str = ""
    help: bool = False

    def rows(self, services: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
        """The rows to show, in order."""
        rows = [row for row in services if self.filter in row["service"]]
        return sorted(rows, key=lambda r: (0 if self.sort == "service" else -r[self.sort], r["service"]))

    def chosen(self, names: Sequence[str]) -> str:
        """The service that keys act on; the first one if the chosen one is gone."""
        return self.selected if self.selected in names else next(iter(names), "")


def pressed(view: View, key: str, names: Sequence[str]) -> tuple[View, Deed | None]:
    """(the view after a key, the action that it asks for). `names`: the services shown."""
    if view.asked:
        return replace(view, asked=None, question="", message=""), view.asked if key in ("y", "Y") else None
    if view.typing:
        return _typed(view, key), None
    if view.help:
        return replace(view, help=False), None
    view, chosen = replace(view, message=""), view.chosen(names)
    if key == "q":
        return view, Deed("quit")
    if key in SORTS:
        return replace(view, sort=SORTS[key]), None
    if key in ("up", "k", "down", "j") and names:
        step = 1 if key in ("down", "j") else -1
        return replace(view, selected=names[min(max(0, names.index(chosen) + step), len(names) - 1)]), None
    if key == "/":
        return replace(view, typing=True, filter=""), None
    if key == "?":
        return replace(view, help=True), None
    if key == "escape":
        return replace(view, filter=""), None
    if key in DEEDS and chosen:
        return _asked(replace(view, selected=chosen), Deed(DEEDS[key], chosen))
    return view, None


def _typed(view: View, key: str) -> View:
    if key == "enter":
        return replace(view, typing=False)
    if key == "escape":
        return replace(view, typing=False, filter="")
    if key == "backspace":
        return replace(view, filter=view.filter[:-1])
    return replace(view, filter=view.filter + key) if len(key) == 1 and key.isprintable() else view


def _asked(view: View, deed: Deed) -> tuple[View, Deed | None]:
    """Asks immediately before a restart; before a release later, when it is known what it releases."""
    if deed.verb == "restart":
        return ask(view, f"Restart {deed.service}?", deed), None
    return view, deed


def ask(view: View, question: str, deed: Deed) -> View:
    """Asks a question before the action."""
    return replace(view, question=question, asked=deed)


def look(before: Usage, now: Usage, status: dict[str, Any]) -> dict[str, Any]:
    """What all services and the machine use: `cpu` in cores between the two looks, `memory` in bytes; busiest first."""
    seconds = max(now["at"] - before["at"], 0.001)
    rows = []
    for name, service in status["services"].items():
        use = now["services"].get(name)
        if use is None and service["state"] == "meta":
            continue
        old = before["services"].get(name, use)
        cores = max(0.0, use["cpu_seconds"] - old["cpu_seconds"]) / seconds if use and old else 0.0
        rows.append(
            {
                "service": name,
                "state": service["state"],
                "cpu": round(cores, 3),
                "memory": use["memory"] if use else 0,
                "priority": service["effective_priority"],
                "why": service["why"],
                "alive": use is not None or bool(service["container"] and service["incarnation"]),
                "measured": use is not None,
            }
        )
    rows.sort(key=lambda r: (-r["cpu"], r["service"]))
    machine = now["machine"]
    cores = (machine["cpu_seconds"] - before["machine"]["cpu_seconds"]) / seconds
    return {
        "services": rows,
        "alive": sum(row["alive"] for row in rows),
        "machine": {**machine, "cpu": round(cores, 3)},
        "pressure": status["pressure"],
        "engine": status.get("engine", {}),
    }


# -- drawing ---------------------------------------------------------------------------------------------------


def header(snapshot: Mapping[str, Any]) -> list[str]:
    """One line each: the engine if it does not answer, the machine, its pressure and budget."""
    machine, pressure = snapshot["machine"], snapshot["pressure"]
    budget = pressure.get("budget") or {}
    parts = [
        f"CPU {budget['cpu']:g} cores" if budget.get("cpu") else "",
        f"memory {format_memory(budget['memory'])}" if budget.get("memory") else "",
    ]
    measures = f"{pressure['reason']} ({', '.join(pressure['measures'])})" if pressure["measures"] else "none"
    silent = snapshot.get("engine", {}).get("silent_since")
    return [
        *([snapshot["engine"]["error"]] if silent else ()),
        f"{snapshot['alive']} alive; CPU {machine['cpu']:.2f} of {machine['cores']:g} cores, memory "
        f"{format_memory(machine['memory'])} of {format_memory(machine['memory_total'])}",
        f"waiting for CPU {machine['cpu_some']:.0f} %, for memory {machine['memory_some']:.0f} %; "
        f"budget {', '.join(filter(None, parts)) or 'none'}; pressure: {measures}",
    ]


def cells_of(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row for people. An engine need not measure what it runs: a Swarm does not."""
    cpu, memory = (f"{row['cpu']:.2f}", format_memory(row["memory"])) if row["measured"] else ("-", "-")
    return {**row, "cpu": cpu, "memory": memory, "why": row["why"] or "-"}


def fitting(rows: Sequence[Mapping[str, Any]], width: int) -> tuple[str, ...]:
    """The columns that fit."""
    shown = list(COLUMNS)
    for dropped in DROPPED:
        widths = dict(zip(shown, cells(rows, shown)[1], strict=True))
        if "why" in widths:
            widths["why"] = min(widths["why"], LEAST_WHY)
        if sum(widths.values()) + 2 * (len(widths) - 1) <= width:
            break
        shown.remove(dropped)
    return tuple(shown)


def frame(view: View, snapshot: Mapping[str, Any] | None, width: int, height: int) -> list[list[tuple[str, str]]]:
    """The lines of the screen, at most `height`: pieces of text with their styles."""
    if view.help:
        return [[(f"{key:<16}", "bold"), (text, "")] for key, text in KEYS][:height]
    text, style = _last_line(view)
    last = [[(line, style)] for line in textwrap.wrap(text, width) or [""]][:height]
    if snapshot is None:
        return last
    head = [[(line, "bold")] for text in header(snapshot) for line in textwrap.wrap(printable(text), width)]
    rows = view.rows(snapshot["services"])
    names = [row["service"] for row in rows]
    chosen = view.chosen(names)
    room = max(1, height - len(head) - 1 - len(last))
    at = names.index(chosen) if chosen else 0
    first = max(0, min(at - room // 2, len(rows) - room))
    told = [cells_of(row) for row in rows]
    shown = fitting(told, width)
    lines, widths = cells(told, shown)
    table = [_row(lines[0], widths, "bold")]
    for line in lines[1 + first : 1 + first + room]:
        table.append(_row(line, widths, "reverse" if line[0] == chosen else ""))
    return [*head[: max(0, height - len(table) - len(last))], *table, *last][:height]


def _row(line: Sequence[str], widths: Sequence[int], style: str) -> list[tuple[str, str]]:
    return [
        (f"{cell:<{width}}  " if i < len(widths) - 1 else cell, style or COLOURS.get(cell, ""))
        for i, (cell, width) in enumerate(zip(line, widths, strict=True))
    ]


def _last_line(view: View) -> tuple[str, str]:
    if view.asked:
        return f"{printable(view.question)} [y/N]", "bold yellow"
    if view.typing:
        return f"filter: {printable(view.filter)}_", "bold"
    if view.message:
        return printable(view.message), "yellow"
    return (f"filter: {printable(view.filter)}  " if view.filter else "") + HINT, "dim"
