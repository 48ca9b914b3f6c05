"""rorg top"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from rorg.cli.options import Option, Output, StateDirectory
from rorg.cli.output import echo

if TYPE_CHECKING:
    from rorg_client.types import Usage


def command(
    once: Annotated[bool, Option(names=("--once",), help="Print one table and end.")] = False,
    interval: Annotated[float, Option(names=("--interval",), least=0.2, help="Seconds between two looks.")] = 1.0,
    output: Output = "table",
    state_dir: StateDirectory = None,
) -> None:
    """What runs, what it uses, who asked for it; and the machine with its pressure. Ends with Ctrl-C."""
    import sys
    import time

    from rorg.cli.context import Context
    from rorg.cli.output import check_form, dump, rich_table, table
    from rorg.cli.terminal import printable

    check_form(output, ("table", "json"))
    client = Context(state_dir, None).serving("look at what runs")
    before = client.usage()
    time.sleep(min(interval, 0.5) if once or output == "json" else 0.3)
    if once or output == "json" or not sys.stdout.isatty():
        found = look(before, client.usage(), client.status())
        if output == "json":
            dump(found, "json")
        else:
            echo(table(found["services"], COLUMNS))
            echo(printable(found["summary"]))
        return
    from rich.console import Group
    from rich.live import Live
    from rich.text import Text

    with Live(auto_refresh=False, screen=True) as live:
        while True:
            now = client.usage()
            found = look(before, now, client.status())
            shown = Group(Text(printable(found["summary"]), style="bold"), rich_table(found["services"], COLUMNS))
            live.update(shown, refresh=True)
            before = now
            time.sleep(interval)


COLUMNS = ("service", "state", "cpu", "memory", "priority", "why")


def look(before: Usage, now: Usage, status: dict[str, Any]) -> dict[str, Any]:
    """Rates between two looks at the usage, busiest first; and the machine in one line."""
    from rorg.model.units import format_memory

    seconds = max(now["at"] - before["at"], 0.001)
    rows = []
    for name, use in now["services"].items():
        service = status["services"].get(name, {})
        old = before["services"].get(name, use)
        cores = max(0.0, use["cpu_seconds"] - old["cpu_seconds"]) / seconds
        rows.append(
            {
                "service": name,
                "state": service.get("state", ""),
                "cpu": f"{cores:.2f}",
                "memory": format_memory(use["memory"]),
                "priority": service.get("effective_priority", ""),
                "why": service.get("why", ""),
            }
        )
    rows.sort(key=lambda r: (-float(r["cpu"]), r["service"]))
    machine = now["machine"]
    cores = (machine["cpu_seconds"] - before["machine"]["cpu_seconds"]) / seconds
    pressure = status["pressure"]
    told = f"; pressure: {pressure['reason']} ({', '.join(pressure['measures'])})" if pressure["measures"] else ""
    return {
        "services": rows,
        "machine": {**machine, "cpu": round(cores, 2)},
        "pressure": pressure,
        "summary": f"{len(rows)} alive; CPU {cores:.2f} of {machine['cores']:g} cores, memory "
        f"{format_memory(machine['memory'])} of {format_memory(machine['memory_total'])}, waiting "
        f"for CPU {machine['cpu_some']:.0f} %, for memory {machine['memory_some']:.0f} %{told}",
    }
