"""rorg fit"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from rorg.cli.context import Context
from rorg.cli.edit import manifests
from rorg.cli.kinds import FILE, moment, number, service_name
from rorg.cli.names import complete_services
from rorg.cli.options import Tree
from rorg.cli.output import disk_errors, echo, missing, note, print_rows
from rorg.cli.records import records_of
from rorg.errors import Invalid
from rorg.model.units import format_memory

if TYPE_CHECKING:
    from rorg.manifest.fitting import Fit
    from rorg.model.workload import Behaviour, Distribution

DAYS = "7d"
"""How far back it looks by default."""
DURATIONS = ("start", "resume", "stop")
LEARNT = (*DURATIONS, "cpu", "memory")


def percent(text: str | float) -> float:
    """The fraction that "10%" or "0.1" stands for."""
    value = number(text.removesuffix("%") if isinstance(text, str) else text)
    value /= 100 if str(text).endswith("%") else 1
    if not 0 <= value <= 1:
        raise typer.BadParameter(f"{text} is not between 0% and 100%")
    return value


Since = Annotated[
    str | None, typer.Option(help="Start: 2h (ago), or 2026-01-31T12:00:00Z. Default: 7d.", parser=moment)
]
Margin = Annotated[
    float,
    typer.Option(
        help="Margin on top of the measured use. Default: 10%.", metavar="PERCENT", parser=percent, show_default=False
    ),
]
WorkloadFile = Annotated[
    Path | None, typer.Option(help="Write a Workload of measured times and use, for `rorg simulate`.", click_type=FILE)
]
Services = Annotated[
    list[str] | None,
    typer.Argument(help="Services. Default: all.", parser=service_name, autocompletion=complete_services),
]
Output = Annotated[
    Literal["diff", "table", "wide", "name", "yaml", "json"],
    typer.Option("-o", "--output", help="diff, table, wide, name, yaml or json."),
]


def command(
    context: Tree,
    services: Services = None,
    since: Since = None,
    margin: Margin = 0.1,
    workload: WorkloadFile = None,
    write: Annotated[bool, typer.Option("--write", help="Write it into the manifests, as `rorg edit` does.")] = False,
    output: Output = "diff",
) -> None:
    """Propose `resources:` for manifests from measured use: the mean CPU and the peak memory of each service while
    it ran. With --workload, learn from the journal how long services take to start, resume and stop, and what
    they use.

    Example: rorg fit navigation --since 24h
    """
    from rorg.manifest.fitting import fit

    tree = manifests(context)
    known = tree.names("Service")
    for name in services or ():
        if name not in known:
            raise missing("service", name, known)
    if workload:
        _learn(context, services or known, since or moment(DAYS), workload, output)
        return
    with records_of(context) as records:
        measured = {entry["service"]: entry for entry in records.measured(since or moment(DAYS))}
    chosen = [n for n in sorted(known) if not services or n in services]
    before = {name: tree.text("Service", name) for name in chosen}
    fits = [fit(name, before[name], measured.get(name), margin) for name in chosen]
    _show(fits, before, output, services or ())
    for one in fits if write else ():
        if one.after:
            tree.text("Service", one.service)  # write() writes the manifest that was read last
            tree.write("Service", one.service, one.text)
            note(f"service {one.service} edited")


def _learn(context: Context, services: Collection[str], since: str, file: Path, output: str) -> None:
    """Writes the Workload, and prints the median and the range of each duration. Raises Invalid without any."""
    from rorg.history.durations import learned_workload, with_use
    from rorg.manifest.workloads import workload_text

    with records_of(context) as records:
        events = (record["event"] for record in records.everything() if "event" in record)
        known = learned_workload("measured", (event for event in events if event["at"] >= since))
        used = with_use(known, records.measured(since))
    if not any(name in services for name in known.services):
        raise Invalid(
            "learn durations", "the journal has no start of these services in that time", "an earlier --since"
        )
    chosen = {name: one for name, one in sorted(used.services.items()) if name in services}
    with disk_errors(f"write {file}", "another file"):
        file.write_text(workload_text(replace(used, services=chosen)), encoding="utf-8")
    rows = [{"service": name, **_told(one)} for name, one in chosen.items()]
    full = [
        {"service": name, **{word: list(getattr(one, word).values) if getattr(one, word) else [] for word in LEARNT}}
        for name, one in chosen.items()
    ]
    print_rows(rows, "table" if output == "diff" else output, ("service", *LEARNT), full=full)


def _told(one: Behaviour) -> dict[str, str]:
    """The median and the range of each duration, and the mean of what it uses."""
    cpu = "-" if one.cpu is None else f"{one.cpu.mean:.3f}"
    memory = "-" if one.memory is None else format_memory(round(one.memory.mean))
    return {**{word: _spread(getattr(one, word)) for word in DURATIONS}, "cpu": cpu, "memory": memory}


def _spread(one: Distribution | None) -> str:
    if one is None:
        return "-"
    least, most = min(one.values), max(one.values)
    return f"{median(one.values):.2f} s ({least:.2f} to {most:.2f}, n={len(one.values)})"


def _show(fits: Sequence[Fit], before: dict[str, str], output: str, named: Collection[str]) -> None:
    changed = [one for one in fits if one.after]
    if output == "diff":
        for one in changed:
            echo(_diff(one, before[one.service]), end="")
        for one in fits:
            if not one.after and (one.service in named or one.seconds):
                note(f"{one.service}: {one.why_not}")
        if not changed:
            note("nothing to change")
        return
    rows = [
        {
            "service": one.service,
            "measured": f"{one.seconds:.0f} s" if one.seconds else "-",
            "cpu": _step(one, "cpu"),
            "memory": _step(one, "memory"),
            "note": one.why_not or "-",
        }
        for one in fits
    ]
    columns = ("service", "measured", "cpu", "memory", "note")
    print_rows(rows, output, columns, full=[one.as_json() for one in fits], below=("note",))


def _step(one: Fit, key: str) -> str:
    before = one.before.get(key, "-")
    return f"{before} -> {one.after[key]}" if key in one.after else before


def _diff(one: Fit, before: str) -> str:
    from difflib import unified_diff

    label = f"services/{one.service}.yaml"
    lines = unified_diff(before.splitlines(), one.text.splitlines(), f"a/{label}", f"b/{label}", lineterm="")
    return "".join(f"{line}\n" for line in lines)
