"""Runs robots on a private Docker engine with `rorg run`, records them, and simulates what was recorded: how far is the
simulator off? Writes recorded.json, from which evaluate.py makes the tables. As root, in a quarter of an hour.

`recorded.py [--anyway FILE] [NAME...]`: a machine that does something else is refused, unless the result goes to
another file. Names choose parts. `make recorded` sets the PYTHONPATH that it needs."""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from statistics import median
from typing import Any

from dockerd import Dockerd, import_base
from recorded_robots import LOADERS, ROBOTS, Robot, busy_robot
from recorded_run import Recorded, record

from rorg.host.load import machine
from rorg.model.workload import Behaviour, Distribution, Workload
from rorg.tools.sim.emulation import agreement
from rorg.tools.sim.results import RunResult
from rorg.tools.sim.simulate import simulate
from rorg.tools.sim.validity import flaws

FILE = Path(__file__).parent / "recorded.json"
SHORT = "short"
"""The name of the part in which the CPU is short."""
DEMANDS = (1.5, 3.0)
"""What burners want, by the machine's cores."""
ALONE = 45.0
"""Seconds of the day on which only loaders run."""
SEED = 1


def figures(result: RunResult) -> dict[str, Any]:
    """What is compared of a run: cores, bytes, seconds."""
    waits = [one.seconds for one in result.responses if one.seconds is not None]
    return {
        "calls": dict(sorted((result.actions or {}).items())),
        "cpu": round(result.cpu, 4),
        "memory": round(result.memory),
        "waits": {
            "count": len(result.responses),
            "never": len(result.responses) - len(waits),
            "median": round(median(waits or [0.0]), 4),
            "sum": round(sum(waits), 4),
            "longest": round(max(waits, default=0.0), 4),
        },
    }


def compared(run: Recorded, workload: Workload, cores: float | None = None) -> dict[str, Any]:
    """The figures of a simulation of a recorded day, and how often the same services are active."""
    found = simulate(run.catalog, run.trace, workload, SEED, every=0.05, cores=cores)
    agreed = agreement(found, run.result)
    times = {"services": round(agreed.services, 4), "sets": round(agreed.sets, 4), "differing": dict(agreed.differing)}
    short = {} if found.shortage is None else {"short": {k: round(v, 2) for k, v in asdict(found.shortage).items()}}
    return {**figures(found), "agreement": times, **short}


def robot_figures(run: Recorded) -> dict[str, Any]:
    """A recorded day beside its simulations: with what was learnt from it, and from the manifests alone."""
    return {
        "seconds": run.trace.duration,
        "services": sum(not one.meta for one in run.catalog.services.values()),
        "other_cpu": round(run.conditions.other, 4),
        "recorded": figures(run.result),
        "learnt": compared(run, run.workload),
        "declared": compared(run, Workload("manifests")),
    }


def busy_figures(run: Recorded, alone: Recorded) -> dict[str, Any]:
    """A day on which the CPU was short beside its simulations, with and without a limit of cores. They know the times
    of a day on which nothing else ran, that a loader takes one core while it comes up, and that a burner, the same
    program with the same `memory:`, has as much."""
    services = {name: replace(alone.workload.of(name), cpu=None, cpu_start=Distribution((1.0,))) for name in LOADERS}
    burner = Behaviour(memory=alone.workload.of("small").memory)
    services |= {name: burner for name in run.catalog.services if name.startswith("burner")}
    workload = replace(alone.workload, services=services)
    return {
        "other_cpu": round(run.conditions.other, 4),
        "recorded": figures(run.result),
        "limited": compared(run, workload, run.conditions.cores),
        "unlimited": compared(run, workload),
    }


@contextmanager
def engine() -> Iterator[str]:
    """A private Docker engine, with the image of the stand-ins."""
    if missing := Dockerd.missing():
        sys.exit(f"cannot record: {missing}")
    with tempfile.TemporaryDirectory(prefix="rorg-dockerd.") as folder:
        docker = Dockerd(Path(folder))
        docker.start()
        try:
            import_base(docker.host)
            os.environ["DOCKER_HOST"] = docker.host
            yield docker.host
        finally:
            docker.close()


class Recording:
    """All runs, on one engine. `anyway`: also on a machine that does something else."""

    def __init__(self, host: str, anyway: bool) -> None:
        self.host, self.anyway = host, anyway
        self.invalid: list[str] = []

    def run(self, name: str, robot: Robot, short: bool = False) -> Recorded:
        """`short`: stand-ins are meant to lack CPU. Ends the program if the machine does something else."""
        print(f"{name}: {robot.seconds:.0f} s", flush=True)
        recorded = record(robot, self.host)
        conditions = replace(recorded.conditions, stand_ins={}) if short else recorded.conditions
        for flaw in flaws(conditions, ()):
            if not self.anyway:
                sys.exit(f"cannot record {name}: {flaw.why}; try {flaw.remedy}")
            self.invalid.append(f"{name}: {flaw.why}")
        return recorded

    def robots(self, names: Sequence[str]) -> dict[str, Any]:
        return {name: robot_figures(self.run(name, ROBOTS[name]())) for name in names}

    def short(self) -> dict[str, Any]:
        cores = machine()["cores"]
        alone = self.run("loaders alone", busy_robot(0, ALONE))
        return {
            f"{times:g}": busy_figures(self.run(f"{times:g} times the cores", busy_robot(times * cores), True), alone)
            for times in DEMANDS
        }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--anyway", type=Path, metavar="FILE", help="measure also on a busy machine, into this file")
    parser.add_argument("names", nargs="*", help=f"of {', '.join([*ROBOTS, SHORT])}; default: all")
    chosen = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that nothing is left behind
    names = chosen.names or [*ROBOTS, SHORT]
    with engine() as host:
        recording = Recording(host, anyway=chosen.anyway is not None)
        found: dict[str, Any] = {"cores": machine()["cores"]}
        found["robots"] = recording.robots([name for name in ROBOTS if name in names])
        found["short"] = recording.short() if SHORT in names else {}
        found["invalid"] = recording.invalid
    (chosen.anyway or FILE).write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
