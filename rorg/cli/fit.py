"""rorg fit"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Annotated

from rorg.cli.edit import manifests
from rorg.cli.options import FORMS, SERVICES, Argument, Option, Tree, moment
from rorg.cli.output import echo, missing, note, print_rows
from rorg.cli.records import records_of

if TYPE_CHECKING:
    from rorg.manifest.fitting import Fit

DAYS = "7d"
"""How far back it looks by default."""


def percent(text: str) -> float:
    """The fraction that "10%" or "0.1" stands for. Raises ValueError."""
    value = float(text.removesuffix("%")) / (100 if text.endswith("%") else 1)
    if not 0 <= value <= 1:
        raise ValueError(f"{text} is not between 0% and 100%")
    return value


def command(
    context: Tree,
    services: Annotated[list[str] | None, Argument("Services. Default: all.", completes=SERVICES)] = None,
    since: Annotated[
        str | None, Option("Start: 2h (ago), or 2026-01-31T12:00:00Z. Default: 7d.", parser=moment)
    ] = None,
    margin: Annotated[
        float,
        Option(
            "Margin on top of the measured use. Default: 10%.", parser=percent, metavar="PERCENT", show_default=False
        ),
    ] = 0.1,
    write: Annotated[bool, Option("Write it into the manifests, as `rorg edit` does.")] = False,
    output: Annotated[
        str, Option("diff, table, wide, name, yaml or json.", names=("-o", "--output"), choices=("diff", *FORMS))
    ] = "diff",
) -> None:
    """Propose `resources:` for manifests from measured use: the mean CPU and the peak memory of each service while
    it ran.

    Example: rorg fit navigation --since 24h
    """
    from rorg.manifest.fitting import fit

    tree = manifests(context)
    known = tree.names("Service")
    for name in services or ():
        if name not in known:
            raise missing("service", name, known)
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
