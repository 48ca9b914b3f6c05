"""Which containers a service is joined to, and whether they are still the current ones (rorg/core/joining.py)."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

from situations import BASE, RUN, SPEC, box, planned, up

from rorg.core.joining import joined_of
from rorg.core.memory import Progress
from rorg.core.observed import Container
from rorg.core.situation import MissingImage
from rorg.core.update import Update
from rorg.core.wanted import Cause
from rorg.model.catalog import Idle, Service, Updating

NET = {**SPEC, "network_mode": "service:base"}
SCAN = Service("scan", spec=NET, needs=("base",), joins={"base": ("network_mode",)})
LOGS = Service("scan", spec={**SPEC, "volumes_from": ["base"]}, needs=("base",), joins={"base": ("volumes_from",)})
PAIR = Updating(atomic="pair")
UP = {"scan": up("scan")}


def scan(to: str = "base", state: str = "running", spec: Any = NET, **more: Any) -> Container:
    return box("scan", state, spec, joined=json.dumps({"base": to}), **more)


def steps(*services: Service, seen: tuple[Container, ...], **more: Any) -> list[str]:
    """Verbs and services of the plan, with what waits."""
    lines = planned(*services, seen=seen, **more)
    return [line if line[0] == "." else " ".join(line.split()[1:3]) for line in lines]


def test_the_label_says_what_it_is_joined_to():
    assert joined_of('{"base": "1"}') == {"base": "1"}
    assert joined_of("") == joined_of("{") == joined_of("[1]") == joined_of("[" * 100_000) == {}


def test_a_new_container_of_one_requires_a_new_one_of_the_other():
    assert steps(BASE, SCAN, seen=(box(), scan())) == []
    found = steps(BASE, SCAN, seen=(box(), scan("an earlier one")))
    assert found[0] == "replace scan"
    assert {"create scan", "stop scan", "start scan"} <= {*found}
    assert steps(BASE, replace(SCAN, joins={}), seen=(box(), scan("an earlier one"))) == [], "it is not joined any more"
    assert steps(BASE, SCAN, seen=(box(), scan("an earlier one")), wanted={"base": (Cause("always_on"),)}) == [
        "stop scan"
    ], "while it is not wanted that does not matter"


def test_nothing_is_made_before_what_it_joins():
    idle = {"wanted": {}}
    first = ["create base", ". wait scan waits for a container of base"]
    assert steps(BASE, SCAN, seen=(), **idle) == first
    assert steps(BASE, SCAN, seen=(box(state="exited"),), **idle) == ["create scan"]
    lost = {"images": {"x": MissingImage("is being pulled", False)}}
    assert "create scan" not in steps(BASE, SCAN, seen=(), **lost, **idle)
    removed = replace(BASE, idle=Idle(action="remove"))
    assert steps(removed, SCAN, seen=(), **idle) == []
    later = replace(BASE, idle=Idle(action="stop", escalate=(60.0, "remove")))
    assert steps(later, SCAN, seen=(), **idle) == []
    kept = replace(BASE, idle=Idle(action="pause", escalate=(60.0, "stop")))
    assert steps(kept, SCAN, seen=(), **idle) == first


def test_a_start_waits_for_the_container_whose_network_it_uses():
    wants = {"wanted": {"scan": (Cause("always_on"),), "base": (Cause("needed", "scan"),)}}
    task = replace(BASE, restart="never")
    ended = box(state="exited", exit_code=0)
    over = {"base": Progress(exited=RUN)}
    idle = scan(state="exited")
    (waits,) = [line for line in steps(task, SCAN, seen=(ended, idle), known=over, **wants) if "scan" in line]
    assert waits.startswith(". wait scan base ")
    assert "start scan" in steps(BASE, SCAN, seen=(box(), idle), **wants)


def test_what_is_joined_by_volumes_outlives_a_run():
    assert steps(BASE, LOGS, seen=(box(), scan(spec=LOGS.spec))) == []
    assert steps(BASE, LOGS, seen=(box(), scan(spec=LOGS.spec)), restarts={"base": RUN}) == ["stop base", "start base"]


def trial(**more: Any) -> dict[str, Any]:
    """`base` has a new container on trial; `scan` runs with the one before."""
    new = box(id="base2", previous="base1", started_at="2026-01-01T12:30:00Z")
    old = box(id="base1", name="base.old", state="exited", spec={"image": "y"}, digest="before")
    progress = Progress(incarnation="base2@2026-01-01T12:30:00Z", running_since=99.5, well_since=99.5, ready=True)
    return {"seen": (new, old, scan("base1")), "known": {"base": progress, **UP}, **more}


def test_who_runs_with_the_container_before_waits_for_the_trial():
    found = steps(BASE, SCAN, **trial())
    assert any(line.startswith(". wait scan base has another container, which is on trial") for line in found)
    assert "stop scan" not in found
    together = steps(replace(BASE, update=PAIR), replace(SCAN, update=PAIR), **trial())
    assert not any("which is on trial" in line for line in together), "they change together"
    stopped = trial()
    seen = (*stopped["seen"][:2], scan("base1", "exited"))
    assert "create scan" in steps(BASE, SCAN, **{**stopped, "seen": seen}), "nothing that runs is lost"
    ceases = steps(BASE, SCAN, **trial(wanted={"base": (Cause("always_on"),)}))
    assert "stop scan" in ceases


def test_after_a_failed_change_of_what_it_joins_it_is_as_before():
    failed = Update(edition="", quarantined={"": "it ended"})
    more = trial()
    more["known"]["base"] = replace(more["known"]["base"], update=failed)
    found = steps(BASE, SCAN, **more)
    assert "create scan" not in found, "base goes back to the container that scan is joined to"


def test_it_leaves_a_failed_container_as_soon_as_the_previous_one_is_back():
    """The failed container is removed only after it, so the two would wait for each other."""
    more = trial()
    new, old, _ = more["seen"]
    ended, back = replace(new, state="exited", exit_code=1), replace(old, state="running", start_number=2)
    progress = Progress(incarnation=back.incarnation, running_since=99.5, well_since=99.5, ready=True)
    for edition in ("failed", "changed since"):
        update = Update(edition=edition, quarantined={"failed": "it ended"}, rejected="base2")
        known = {"base": replace(progress, update=update), **UP}
        found = steps(BASE, SCAN, seen=(ended, back, scan("base2")), known=known)
        assert "create scan" in found, found
