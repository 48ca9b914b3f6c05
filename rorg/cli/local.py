"""What commands compute themselves if no running rorg answers."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from rorg.core.decide import Decision, decide, unlocked
from rorg.core.desired import Desired, desire
from rorg.core.inputs import Inputs
from rorg.core.memory import Memory
from rorg.core.observed import Observed
from rorg.core.peers import NOBODY, Peers
from rorg.core.schedule import Target
from rorg.daemon.saved_memory import remembered
from rorg.daemon.snapshot import down_of, snapshot
from rorg.engines.protocol import Engine, Objects
from rorg.errors import Invalid, Unreachable
from rorg.history.database import reading
from rorg.history.runs import Runs
from rorg.host.clock import boot_id, moment
from rorg.host.contents import Contents
from rorg.host.devices import elsewhere, look
from rorg.images.references import references_for
from rorg.model.catalog import Catalog
from rorg.model.devices import Device, Plugged
from rorg.model.engines import capabilities_of
from rorg.probes.runner import ProbeRunner
from rorg.store.last_good import read_kept
from rorg.store.requests_document import RequestsDocument
from rorg.store.state_dir import StateDir


class Place(Protocol):
    """The robot to look at: a Context."""

    state: StateDir

    @property
    def engine_name(self) -> str: ...
    @property
    def root(self) -> Path: ...
    def catalog(self) -> Catalog: ...
    def document(self) -> RequestsDocument: ...
    def engine(self) -> Engine: ...


DOWN = "the robot is down"
"""Why nothing is active on a robot that was taken down."""


def decision(place: Place, catalog: Catalog) -> Decision:
    """One pass that changes nothing: observation, resolution, plan. Raises Unreachable."""
    images = references_for(place.engine_name, place.state.path).of(catalog).references
    return decision_for(place, desire(catalog, str(place.state.run), Contents().of(catalog, place.root), images))


def decision_for(place: Place, desired: Desired) -> Decision:
    """The same for what a tree declares or declared."""
    engine = place.engine()
    objects = engine.find_objects(desired.keys) if isinstance(engine, Objects) else None
    containers = tuple(engine.list())
    observed = Observed(containers, objects=objects, looked=dict.fromkeys((c.id for c in containers), time.monotonic()))
    first = _look(place, desired, observed)
    return _look(place, desired, observed, _ready(place, first, desired))


def glance(place: Place, catalog: Catalog) -> Decision:
    """The same without probes, which do not affect what may be requested. If the engine does not answer, nothing is
    known of what runs, as in a pass of the loop."""
    try:
        observed = Observed(tuple(place.engine().list()))
    except Unreachable as error:
        observed = Observed((), complete=False, error=str(error))
    return _look(place, desire(catalog), observed)


def _look(place: Place, desired: Desired, observed: Observed, memory: Memory | None = None) -> Decision:
    """The decision of one pass, with the memory of the last rorg unless another is given."""
    document, present = place.document(), moment()
    if memory is None:
        memory = replace(_remembered(place), kept=read_kept(place.state.path))
    return decide(
        Inputs(
            desired=desired,
            requests=document.requests,
            restarts=document.restarts,
            observed=observed,
            results=unlocked(desired, present.uptime),
            memory=memory,
            now=present.uptime,
            owner=place.state.instance(),
            engine=capabilities_of(place.engine_name),
            holds=document.holds,
            suspended=document.suspended,
            wall=present.wall,
            boot=present.boot,
            confirmed=document.removals,
            retries=document.retries,
            devices=devices(place, desired),
            peers=Peers(excluded=dict.fromkeys(desired.digests, DOWN)) if document.down else NOBODY,
        )
    )


def devices(place: Place, desired: Desired) -> dict[Device, Plugged]:
    """The state of the devices of drivers."""
    if not desired.devices:
        return {}
    return look(desired.devices) if place.engine().local else elsewhere(desired.devices)


def _remembered(place: Place) -> Memory:
    """What the running rorg, or the last one, would pass on to the next one: nothing if the history is damaged."""
    runs: dict[str, Any] = {}
    with suppress(Invalid), reading(place.state.journal) as database:
        runs = Runs(database).read()
    return remembered(runs, time.monotonic(), boot_id())


def _ready(place: Place, first: Decision, desired: Desired) -> Memory:
    """The memory with what is ready now, by asking each probe once: this process has not seen anything become ready."""
    progress, now = dict(first.situation.memory.progress), first.situation.now
    containers = first.situation.observed.by_service()
    ask = ProbeRunner(place.engine(), lambda name: next(iter(containers.get(name, [])), None))
    for name, step in progress.items():
        service = desired.catalog.services.get(name)
        ready = service.ready if service else None
        if step.running_since is None:
            continue
        if ready is not None and ready.completed:
            continue
        parts = Target(ready, step.incarnation, now).parts() if ready is not None and ready.delay is None else ()
        if all(ask((name, "ready"), part).ok for part in parts):
            progress[name] = replace(step, running_since=now, ready=True)
    return Memory(progress, kept=first.memory.kept)


def view(place: Place) -> dict[str, Any]:
    """What a running rorg would publish."""
    catalog = place.catalog()
    return snapshot(
        decision(place, catalog),
        {
            "pid": None,
            "engine_name": place.engine_name,
            "down": down_of(place.document()),
            "tree": {
                "root": str(place.root),
                "fingerprint": catalog.fingerprint,
                "revision": "",
                "robot": "",
                "git": None,
                "errors": [],
            },
        },
    )
