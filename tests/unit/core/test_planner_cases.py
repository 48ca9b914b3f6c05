"""The planner on data: manifests + requests + what is observed + what is remembered -> the exact text of the plan,
and of its overview where the case has one.

Each file of cases/planner is one case. A running service is ready unless `memory` says otherwise; containers are named
like their service, with their name as id unless that is said, and were created from the declared spec unless `spec`
says what differed. Each was looked at just now, unless `looked` says when. `answers` say when probes were asked last,
which say yes unless it is said how often they said no.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from common import ROOT

from rorg.core.decide import decide
from rorg.core.desired import desire
from rorg.core.digest import canonical, declared_fields, digest
from rorg.core.inputs import Inputs
from rorg.core.memory import Attempt, CountedOn, InFlight, Memory, ProbeResult, Progress
from rorg.core.objects import found_object, object_labels
from rorg.core.observed import Container, FoundObjects, Observed
from rorg.core.operations import Create, Operation, Pause, Resume, Start, Stop
from rorg.core.overview import Overview
from rorg.core.plan import Action
from rorg.core.pressure import Pressure, Shed
from rorg.core.ros_graph import RosGraph
from rorg.core.situation import MissingImage
from rorg.core.update import Update
from rorg.manifest.load import load_or_raise
from rorg.manifest.yaml_source import read_yaml
from rorg.model.catalog import Hold, Request, Service
from rorg.model.devices import Plugged
from rorg.model.load import Load
from rorg.model.objects import EngineObject
from rorg.model.options import LIVE
from rorg.model.units import parse_time

CASES = sorted((ROOT / "tests/cases/planner").glob("*.yaml"))
KEYS = {
    "about",
    "services",
    "groups",
    "requests",
    "observed",
    "complete",
    "memory",
    "in_flight",
    "now",
    "removals",
    "restarts",
    "plan",
    "overview",
    "contents",
    "images",
    "dropped",
    "policy",
    "holds",
    "suspended",
    "interlocks",
    "pressure",
    "devices",
    "networks",
    "volumes",
    "found",
    "purge",
    "ros",
    "unreported",
    "answers",
}
STARTED = "2026-01-01T00:00:00Z"
UNDER_WAY: Mapping[str, Operation] = {
    "create": Create(name="one", spec={}, labels={}, digest=""),
    "start": Start(container="one"),
    "resume": Resume(container="one"),
    "pause": Pause(container="one"),
    "stop": Stop(container="one", signal="SIGTERM", grace=5.0, incarnation=""),
    "stop paused": Stop(container="one", signal="SIGTERM", grace=5.0, incarnation="", resumes=True),
}
"""Of a call that a case has in flight only its kind counts."""


def read_case(path: Path) -> dict:
    document, diagnostics = read_yaml(path.read_text(encoding="utf-8"), path.name)
    assert not diagnostics
    assert set(document.value) <= KEYS, set(document.value) - KEYS
    return document.value


def catalog_of(case: dict, root: Path):
    """The catalog of a case, by way of a real tree of manifests."""
    kinds = {
        "Service": {n: {"image": "img", **(s or {})} for n, s in case["services"].items()},
        "Group": {n: {"services": members} for n, members in case.get("groups", {}).items()},
        "Policy": {"policy": case["policy"]} if "policy" in case else {},
        "Network": {n: s or {} for n, s in case.get("networks", {}).items()},
        "Volume": {n: s or {} for n, s in case.get("volumes", {}).items()},
    }
    for kind, specs in kinds.items():
        folder = root / {"Policy": "policies"}.get(kind, f"{kind.lower()}s")
        folder.mkdir()
        for name, spec in specs.items():
            if spec.get("type") == "meta":
                spec.pop("image")
            text = {"apiVersion": "rorg/v1", "kind": kind, "metadata": {"name": name}, "spec": spec}
            (folder / f"{name}.yaml").write_text(yaml.safe_dump(text), encoding="utf-8")
    return load_or_raise(root)


def created_from(declared: dict, override: object) -> dict:
    """The spec of a container: the declared one, with what differed when it was created (null: was not there)."""
    spec = dict(declared)
    for option, value in ({} if override == "declared" else override).items():
        value = {**spec.get(option, {}), **value} if isinstance(value, dict) else value
        spec[option] = {k: v for k, v in value.items() if v is not None} if isinstance(value, dict) else value
    return {k: v for k, v in spec.items() if v is not None}


def container_of(entry: dict, catalog) -> Container:
    service, name = entry["service"], entry.get("name", entry["service"])
    declared = catalog.services[service].spec if service in catalog.services else {"image": "img"}
    spec = created_from(declared, entry.get("spec", "declared"))
    live = {k: v for k, v in spec.items() if k in LIVE - {"container_name"}}
    started = "" if entry["state"] == "created" else entry.get("started_at", STARTED)
    return Container(
        id=entry.get("id", name),
        name=name,
        service=service,
        state=entry["state"],
        started_at=started,
        exit_code=entry.get("exit_code"),
        digest=entry.get("digest", digest(spec)),
        declared=canonical(declared_fields(spec)),
        live={**live, **entry.get("live", {})},
        oom_killed=entry.get("oom_killed", False),
        previous=entry.get("previous", ""),
        devices=canonical(entry["devices"]) if "devices" in entry else "",
        networks=entry.get("networks", {}),
        joined=canonical(entry["joined"]) if "joined" in entry else "",
        created_at=entry.get("created_at", ""),
    )


def plugged(said: str) -> Plugged:
    """ "c 188:0 /dev/ttyUSB0", or why it cannot be used."""
    kind, *rest = said.split(" ")
    return Plugged(" ".join(rest[1:]), f"{kind} {rest[0]}") if kind in ("b", "c") else Plugged(problem=said)


def graphs_of(case: dict) -> dict[str, RosGraph]:
    """By master: `nodes` with the services that run them, and who publishes and subscribes."""
    return {
        master: RosGraph(
            nodes=said["nodes"],
            **{part: {topic: tuple(nodes) for topic, nodes in said[part].items()} for part in set(said) - {"nodes"}},
        )
        for master, said in case.get("ros", {}).items()
    }


def objects_of(case: dict, desired) -> FoundObjects | None:
    """Networks and volumes that are there, each of ours made from what is declared unless `spec` says what differed."""
    if not case.keys() & {"networks", "volumes", "found"}:
        return None
    declared = {one.key: one for one in desired.objects.values()}
    found = {}
    for entry in case.get("found", []):
        kind = "network" if "network" in entry else "volume"
        called, owner = entry[kind], entry.get("owner", "robot")
        one = declared.get(f"{kind}/{called}", EngineObject(kind, called, called))
        one = replace(one, spec=created_from(one.spec, entry.get("spec", "declared")))
        labels = object_labels(one, owner) if owner else {}
        found[one.key] = found_object(kind, called, entry.get("id", called), labels)
    return FoundObjects(found, frozenset(declared), complete=True)


def memory_of(case: dict, containers: list[Container], editions: Mapping[str, str]) -> Memory:
    # rorg has seen all runs.
    progress = {c.service: Progress(incarnation=c.incarnation) for c in reversed(containers) if c.state == "exited"}
    progress |= {
        c.service: Progress(running_since=0.0, ready=True, incarnation=c.incarnation)
        for c in containers
        if c.state == "running"
    }
    for name, known in case.get("memory", {}).items():
        if "update" in known:
            said, edition = dict(known["update"]), editions[name]  # an error is that of what the manifest says now
            quarantined = {edition: said.pop("error")} if "error" in said else {}
            known = {**known, "update": Update(edition=edition, quarantined=quarantined, **said)}
        if "stopped" in known:
            known = {**known, "stopped": tuple(known["stopped"])}
        tried = {verb: Attempt(**attempt) for verb, attempt in known.get("attempts", {}).items()}
        known = {**known, "attempts": tried} if tried else known
        if "removals" in known:
            known = {**known, "removals": {id: Attempt(**tried) for id, tried in known["removals"].items()}}
        if "counted_on" in known:
            known = {**known, "counted_on": CountedOn(**known["counted_on"])}
        progress[name] = replace(progress.get(name, Progress()), **known)
    flights = {
        name: InFlight(Action(0, UNDER_WAY[verb], name), case["now"] - 1.0)
        for name, verb in case.get("in_flight", {}).items()
    }
    pressure = dict(case.get("pressure", {}))
    shed = tuple(Shed(name, 0.0, 0, why) for name, why in pressure.pop("shed", {}).items())
    return Memory(progress, flights, pressure=Pressure(**pressure, shed=shed))


def answers_of(
    case: dict, containers: list[Container], services: Mapping[str, Service]
) -> dict[tuple[str, str], ProbeResult]:
    """What probes have said of runs."""
    runs = {c.service: c.incarnation for c in containers if c.state == "running"}
    return {
        (name, role): ProbeResult(
            runs[name],
            "no" not in said,
            said["at"],
            "no answer",
            said.get("no", 0),
            getattr(services[name], role),
        )
        for name, roles in case.get("answers", {}).items()
        for role, said in roles.items()
    }


@pytest.mark.parametrize("path", CASES, ids=lambda p: p.stem)
def test_plan(path, tmp_path):
    case = read_case(path)
    catalog = catalog_of(case, tmp_path)
    containers = [container_of(entry, catalog) for entry in case.get("observed", [])]
    requests = tuple(
        Request(
            r["id"],
            r.get("requester", "developer"),
            tuple(r["services"]),
            incarnation=r.get("incarnation"),
            priority=r.get("priority"),
            ttl=r.get("ttl"),
        )
        for r in case.get("requests", [])
    )
    now = float(case["now"])
    wall = parse_time("2026-02-01T00:00:00Z") + now
    holds = {n: Hold(wall + h["for"], h.get("reason", "")) for n, h in case.get("holds", {}).items()}
    suspended = Hold(wall + case["suspended"]["for"], case["suspended"]["reason"]) if "suspended" in case else None
    results = {
        (n, "interlock"): ProbeResult("", said == "allows", now, said) for n, said in case.get("interlocks", {}).items()
    }
    results |= answers_of(case, containers, catalog.services)
    looked = [entry.get("looked", now) for entry in case.get("observed", [])]
    known = case.get("devices", {})
    quiet = Load(0.0, 0.0, 4.0, 0, 8 << 30)
    desired = desire(catalog, contents=case.get("contents"))
    decision = decide(
        Inputs(
            desired=desired,
            requests=requests,
            restarts=case.get("restarts", {}),
            observed=Observed(
                tuple(containers),
                complete=case.get("complete", True),
                objects=objects_of(case, desired),
                looked=dict(zip((c.id for c in containers), looked, strict=True)),
            ),
            results=results,
            memory=memory_of(case, containers, desired.editions),
            now=now,
            owner="robot",
            holds=holds,
            removals=case.get("removals", True),
            suspended=suspended,
            wall=wall,
            load=quiet,
            purge=case.get("purge", False),
            ros=graphs_of(case),
            unreported=case.get("unreported", {}),
            images={r: MissingImage(**m) for r, m in case.get("images", {}).items()},
            devices={d: plugged(known[d.identity]) for d in desired.devices if d.identity in known},
        )
    )
    assert decision.plan.text() == case["plan"]
    if "overview" in case:
        entries = Overview(decision.situation, decision.plan).as_json()
        assert "".join(f"{e['line']}\n" for e in entries) == case["overview"]
    assert decision.violations == ()
    assert [f"{r.id}: {why}" for r, why in decision.settled.dropped] == case.get("dropped", [])


def test_enough_cases():
    assert len(CASES) >= 20
