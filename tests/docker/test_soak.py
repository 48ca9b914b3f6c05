"""Steady work for SOAK_MINUTES (`make soak`), or for some seconds: rorg uses no more than at the start, and what runs
at the end is what is asked for."""

from __future__ import annotations

import os
import random
import time
from collections import Counter
from dataclasses import fields

import pytest
from common import wait_for
from histories import small_disk
from soak import PERCEPTION, SoakedRorg, Work, differences, services
from soak_faults import Faults
from soak_samples import Sample, Slope, sample, slope

SECONDS = 60 * float(os.environ.get("SOAK_MINUTES") or 0) or 20.0
EVERY = min(5.0, SECONDS / 20)
"""Seconds between two samples."""
DISK = "96m"
"""Of the state directory, which is full now and then."""
LONG = 900.0
"""Seconds of a run whose slopes must keep to BOUNDS: in a shorter one caches are still filling."""
BOUNDS = {"heap": 0.3, "descriptors": 0.2, "threads": 0.2, "engine": 0.5, "latency": 0.02}
"""The most that may be gained a minute, over the second half. The heap in MB; PSS is printed but not judged, since it
also rises when others end who shared pages of files."""


@pytest.fixture
def rorg(dockerd, tmp_path):
    with small_disk(tmp_path / "state", DISK):
        found = SoakedRorg(tmp_path, dockerd.host, services(), groups={"perception": {"services": [*PERCEPTION]}})
        yield found
        found.close()


def test_steady_work_leaves_rorg_as_it_was(dockerd, rorg):
    faults = Faults(rorg, dockerd, min(180.0, max(30.0, SECONDS / 8)))
    samples, types, work = soaked(rorg, faults)
    slopes = told(samples, types, work, faults)
    wait_for(lambda: not rorg.client.requests(), 60, "leases to run out")
    with rorg.client.request("navigation", "gripper"), rorg.robot.client("tour").request("map"):
        asked = ("navigation", "gripper", "map")
        try:
            wait_for(lambda: not differences(rorg, asked), 180, "what runs is what is asked for")
        finally:
            wrong = differences(rorg, asked)
            print(f"at the end {len(rorg.specs)} services, {len(wrong)} not as asked for: {'; '.join(wrong) or 'none'}")
    assert not wrong
    assert not work.errors, "\n".join(work.errors[:5])
    log = rorg.log.read_text()
    assert "internal error" not in log, log[log.find("internal error") :][:4000]
    if SECONDS >= LONG:
        assert not {name: str(slopes[name]) for name, bound in BOUNDS.items() if slopes[name].above(bound)}


def soaked(rorg: SoakedRorg, faults: Faults) -> tuple[list[Sample], list[dict[str, int]], Work]:
    """Samples of the whole time, and how many objects of each type there were in the middle and at the end."""
    rorg.client.wait("clock", "tour", "diagnostics", timeout=120.0)
    work, began = Work(rorg, faults.excuse), time.monotonic()
    samples: list[Sample] = []
    types: list[dict[str, int]] = []
    work.start()
    while (at := time.monotonic() - began) < SECONDS or len(samples) < 6:
        samples.append(sample(rorg, began))
        if not types and at >= SECONDS / 2:
            types.append(rorg.ask("types"))
        faults.cause()
        time.sleep(EVERY)
    types.append(rorg.ask("types"))
    work.stop()
    return samples, types, work


def told(samples: list[Sample], types: list[dict[str, int]], work: Work, faults: Faults) -> dict[str, Slope]:
    """Prints what was done and found."""
    second = samples[len(samples) // 2 :]
    done = ", ".join(f"{count} {name}" for name, count in sorted(work.counts.items()))
    caused = ", ".join(f"{count} {name}" for name, count in sorted(faults.counts.items())) or "none"
    print(f"\n{samples[-1].at:.1f} minutes, {len(samples)} samples, {len(work.errors)} errors; done: {done}")
    print(f"faults: {caused}; {work.excused} calls failed during them or soon after")
    print(f"{'':12} {'first':>10} {'middle':>10} {'last':>10}   slope over the second half")
    slopes = {}
    for name in (f.name for f in fields(Sample) if f.name != "at"):
        slopes[name] = slope([(s.at, getattr(s, name)) for s in second])
        shown = " ".join(f"{getattr(s, name):10.2f}" for s in (samples[0], second[0], samples[-1]))
        print(f"{name:12} {shown}   {slopes[name]}")
    grown = Counter({name: count - types[0].get(name, 0) for name, count in types[-1].items()})
    print("objects since the middle:", ", ".join(f"{name} {count:+}" for name, count in grown.most_common(12)))
    return slopes


def test_growth_is_told_from_noise():
    chance = random.Random(1)
    flat = [(n / 12, 60 + chance.gauss(0, 0.3)) for n in range(120)]
    assert not slope(flat).above(0.0)
    grows = [(at, value + 0.1 * at) for at, value in flat]
    assert slope(grows).above(0.05)
    assert not slope(grows).above(0.1)
    steps = [(at, 60.0 + (at > 5) * 2) for at, _ in flat]  # once, as when a cache is filled
    assert not slope(steps).above(0.3)
