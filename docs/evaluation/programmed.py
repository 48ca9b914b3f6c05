"""The robot of real programs (programs/robot): its states, what programs.py measured of it, and the tables of
docs/evaluation.md. Nothing here measures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from statistics import mean
from typing import Any

from rorg.manifest.load import load_or_raise
from rorg.manifest.traces import read_trace
from rorg.manifest.yaml_text import yaml_text
from rorg.model.catalog import Catalog
from rorg.model.graph import closure
from rorg.model.trace import Trace, TraceEvent
from rorg.model.units import format_duration

HERE = Path(__file__).parent
ROBOT, FILE = HERE / "programs/robot", HERE / "programs.json"
TRACE, WORKLOAD = HERE / "programs/hour.yaml", HERE / "programs/workload.yaml"
IMAGE = "robot-of-programs"
TIMES = ("start", "resume", "stop")
MB = 1e6

_LOOK = ("camera", "face_detection", "microphone", "wakeword", "database")
_DRIVE = ("laser", "map_server", "localization", "navigation", "slow_camera", "recorder")
STATES: Mapping[str, tuple[str, ...]] = {
    "start": (),
    "standby": _LOOK,
    "greet": (*_LOOK, "recogniser", "speech", "web"),
    "tour": (*_DRIVE, "people_detection", "speech"),
    "return": _DRIVE,
}
"""What the behaviour requests in each state, in addition to what the robot is never without."""
WINDOWS = ("standby", "greet", "tour")
"""States in which the programs are measured."""
SUBSCRIBERS = ("face_detection", "people_detection")
"""Programs that work only while another one subscribes to their results."""
STAY = "the same, but detections work all the time"
"""The row in which nobody ever unsubscribes from them."""
OF_HOUR = {"chat": "greet"}
"""States that the trace of the other robot calls otherwise."""


@cache
def robot() -> Catalog:
    return load_or_raise(ROBOT)


def programs() -> list[str]:
    return sorted(name for name, one in robot().services.items() if not one.meta)


def hour() -> Trace:
    """The hour of hour.yaml, on this robot."""
    of = read_trace(HERE / "hour.yaml")
    states = [(e.at, OF_HOUR.get(e.state, e.state)) for e in of.events if e.state]
    events = (TraceEvent(at, "developer", "developer", STATES[state], state) for at, state in states)
    return replace(of, name="programs-hour", events=tuple(events))


def load() -> Mapping[str, Any]:
    """The measurements. Raises ValueError if they are not valid."""
    found: Mapping[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))
    if wrong := [why for one in found["rounds"] for why in one["invalid"]]:
        raise ValueError(f"{FILE.name} was measured on a busy machine: {'; '.join(wrong)}")
    return found


def used_in(name: str) -> tuple[str, ...]:
    """The windows in which a program is used, by the state or by what it requests. Programs that the robot is never
    without are used in all of them."""
    services = robot().services
    return tuple(state for state in WINDOWS if name in closure(services, STATES[state])) or WINDOWS


def values(found: Mapping[str, Any], name: str, what: str, windows: tuple[str, ...]) -> list[float]:
    """What a program took in these windows of all rounds."""
    return [one["windows"][state]["services"][name][what] for one in found["rounds"] for state in windows]


def times(found: Mapping[str, Any], name: str, what: str) -> list[float]:
    return [s for one in found["rounds"] for s in one["times"]["services"].get(name, {}).get(what, [])]


def workload_text(found: Mapping[str, Any]) -> str:
    """The workload that the measurements say, for `rorg simulate`."""

    def both(name: str, what: str) -> dict[str, list[float]]:
        return {"active": values(found, name, what, used_in(name)), "idle": values(found, name, what, ("idle",))}

    def durations(seconds: list[float]) -> list[str]:
        return [format_duration(one) for one in seconds]

    rounds = found["rounds"]
    verbs = sorted({verb for one in rounds for verb in one["times"]["calls"]})
    calls = {v: durations([s for one in rounds for s in one["times"]["calls"].get(v, [])]) for v in verbs}
    services = dict[str, dict[str, Any]]()
    for name in programs():
        services[name] = {"cpu": both(name, "cpu"), "memory": both(name, "memory")}
        services[name] |= {what: durations(t) for what in TIMES if (t := times(found, name, what))}
    spec = {"calls": calls, "services": services}
    metadata = {"name": "programs", "description": "Measured by programs.py."}
    return yaml_text({"apiVersion": "rorg/v1", "kind": "Workload", "metadata": metadata, "spec": spec})


# -- tables ------------------------------------------------------------------------------------------------------------


def spread(measured: list[float], size: float, form: str) -> str:
    """The mean, and the least and the most."""
    if not measured:
        return "-"
    cells = [f"{one / size:{form}}" for one in (mean(measured), min(measured), max(measured))]
    return cells[0] if cells[1] == cells[2] else f"{cells[0]} ({cells[1]} to {cells[2]})"


def programs_table(_: Mapping[str, Any]) -> str:
    """For each program: CPU, memory and times."""
    found = load()
    lines = [
        "| program | CPU idle, % of a core | CPU in use | idle / in use | memory, MB | files, MB | start | resume |",
        "|---|---|---|---|---|---|---|---|",
    ]
    total = [0.0, 0.0, 0.0, 0.0]
    for name in sorted(programs(), key=lambda n: -mean(values(found, n, "cpu", used_in(n)))):
        idle, used = (values(found, name, "cpu", windows) for windows in (("idle",), used_in(name)))
        memory, files = (values(found, name, what, used_in(name)) for what in ("memory", "files"))
        seconds = (f"{spread(times(found, name, what), 1, '.2f')} s" for what in ("start", "resume"))
        total = [a + mean(b) for a, b in zip(total, (idle, used, memory, files), strict=True)]
        lines.append(
            f"| {name} | {spread(idle, 0.01, '.1f')} | {spread(used, 0.01, '.1f')} | {_part(mean(idle), mean(used))} "
            f"| {mean(memory) / MB:.0f} | {mean(files) / MB:.0f} | {' | '.join(seconds)} |"
        )
    lines.append(
        f"| all | {100 * total[0]:.1f} | {100 * total[1]:.1f} | {_part(total[0], total[1])} | {total[2] / MB:.0f} "
        f"| {total[3] / MB:.0f} | | |"
    )
    return "\n".join(lines)


def _part(idle: float, used: float) -> str:
    return f"{100 * idle / used:.0f} %" if used >= 0.001 else "-"


def saved_table(figures: Mapping[str, Any]) -> str:
    """What rorg saves on this robot, by state and by what unused programs take."""
    of = figures["programs"]
    lines = ["| | everything on | rorg | CPU | memory |", "|---|---|---|---|---|"]
    for name, row in {"the hour": of["hour"], **of["states"]}.items():
        lines.append(f"| {name} | {_use(row)} | {_saved(row)} |")
    lines += ["", "| the hour, if unused programs take | CPU | memory |", "|---|---|---|"]
    for name, row in {"what was measured": of["first"], **of["idle use"]}.items():
        lines.append(f"| {name} | {_saved(row)} |")
    lines += ["", "| request | number | median | 95 % | longest | never ready |", "|---|---|---|---|---|---|"]
    for state, one in of["waits"].items():
        cells = " | ".join(f"{one[k]:.2f} s" for k in ("median", "p95", "most"))
        lines.append(f"| {state} | {one['count']} | {cells} | {one['never']} |")
    return "\n".join(lines)


def _use(row: Mapping[str, float]) -> str:
    return " | ".join(f"{row[f'cores_{how}']:.2f} cores, {row[f'gb_{how}']:.2f} GB" for how in ("all_on", "rorg"))


def _saved(row: Mapping[str, float]) -> str:
    return f"{-row['cpu']:.1f} % | {-row['memory']:.1f} %"


def headline_rows(figures: Mapping[str, Any]) -> list[str]:
    of = figures["programs"]
    row, stay = of["hour"], of["idle use"][STAY]
    saved = f"(CPU {-row['cpu']:.0f} %, memory {-row['memory']:.0f} %)"
    kind = "programs measured, use simulated"
    return [
        f"| hour of a smaller robot of real programs | {_use(row)} {saved} | {kind} |",
        f"| the same, with detection always on | | CPU {-stay['cpu']:.0f} % | {kind} |",
    ]


def write() -> None:
    """Writes the trace and the workload again."""
    from rorg.manifest.traces import trace_text

    TRACE.write_text(trace_text(hour()), encoding="utf-8")
    WORKLOAD.write_text(workload_text(load()), encoding="utf-8")
