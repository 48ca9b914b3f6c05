"""How long simulations take on one core: CPU seconds, since other programs of the machine have theirs."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import replace
from resource import RUSAGE_CHILDREN, getrusage

from common import ROOT

from rorg.manifest.load import load_or_raise
from rorg.model.catalog import Catalog
from rorg.model.workload import Workload
from rorg.tools.sim.generate import generate_day
from rorg.tools.sim.simulate import simulate


def test_the_day_of_41_services_as_a_command():
    """With everything on and with time-sharing, the start of Python included."""
    words = ["simulate", ROOT / "docs/evaluation/day.yaml", ROOT / "manifests", "-o", "json"]
    before = getrusage(RUSAGE_CHILDREN)
    found = json.loads(subprocess.run([sys.executable, "-m", "rorg", *words], capture_output=True, check=True).stdout)
    used = getrusage(RUSAGE_CHILDREN)
    seconds = used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime
    print(f"\n4 h, 188 greetings, 10 tours, 41 services, both runs: {seconds:.2f} s", end="")
    assert found["runs"][1]["responses"]["tour"]["count"] == 10
    assert seconds < 5


def test_24_hours_of_300_services():
    """With everything on and without: the tour guide beside six more robots that do nothing but what is always on."""
    catalog = enlarged(load_or_raise(ROOT / "manifests"), 300)
    trace = generate_day(86400.0, 1128, 60, 1)
    began = time.process_time()
    results = [simulate(catalog, trace, Workload(), 1, all_on=on) for on in (True, False)]
    seconds = time.process_time() - began
    print(f"\n24 h, 1128 greetings, 60 tours, 300 services, both runs: {seconds:.1f} s", end="")
    assert not any(result.violations for result in results)
    assert seconds < 60


def enlarged(catalog: Catalog, count: int) -> Catalog:
    """With copies of its services, which need each other, until there are so many."""
    own = {n: s for n, s in catalog.services.items() if not s.meta}
    found = dict(catalog.services)
    copy = 0
    while sum(not s.meta for s in found.values()) < count:
        copy += 1
        left = count - sum(not s.meta for s in found.values())
        names = sorted(own, key=lambda n: (bool(own[n].needs), n))[:left] if left < len(own) else list(own)
        for name in names:
            service = own[name]
            found[f"{name}-{copy}"] = replace(
                service,
                name=f"{name}-{copy}",
                needs=tuple(f"{n}-{copy}" for n in service.needs if n in names),
                conflicts=tuple(f"{n}-{copy}" for n in service.conflicts),
                spec={**(service.spec or {}), "container_name": f"{name}-{copy}"},
            )
    return replace(catalog, services=found)
