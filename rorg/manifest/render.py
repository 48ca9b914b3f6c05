"""From one Service manifest and its profile to the service that is decided about, with its container rendered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from rorg.manifest.documents import Source
from rorg.manifest.driver import hardware
from rorg.manifest.probes import FORMS
from rorg.manifest.profiles import SHIPPED, Merged
from rorg.manifest.rendered_container import container_of
from rorg.manifest.ros_parameters import parameters_of
from rorg.model.catalog import Idle, Probe, Service, Updating
from rorg.model.diagnostics import Diagnostic
from rorg.model.policy import Budget, HistoryPolicy, ImagePolicy, Policy, Thresholds
from rorg.model.ros import without_master

ROS_MASTER = "http://localhost:11311"
"""Where ROS 1 looks for its master when ROS_MASTER_URI is not set."""


INTERVALS = {"ready": 0.25, "live": 10.0, "interlock": 0.25}
"""Seconds between two probes, where the manifest does not say. An exec costs the engine 50 ms, so it waits longer."""
EXEC_INTERVAL = 1.0


def render(source: Source, profile: Merged, policy: Any, engine: str = "") -> tuple[Service, list[Diagnostic]]:
    """The service of a manifest. `profile` already stands on `common`; `policy` is the Policy's spec, or None; `engine`
    the name of what is to run it, where that is known."""
    spec: Any = source.spec
    diagnostics, meta = list[Diagnostic](), spec.type == "meta"
    needs = list(spec.needs) + [n for n in profile.needs if n.service != source.name and not meta]
    container, origins, secrets = ({}, {}, ()) if meta else container_of(source, profile, diagnostics, engine)
    protected, interlock = _guard(spec, policy)
    master = _master(container)
    service = Service(
        name=source.name,
        meta=meta,
        always_on=spec.always_on,
        needs=tuple(dict.fromkeys(n.service for n in needs)),
        restarts_with=tuple(sorted({n.service for n in needs if n.restart})),
        conflicts=tuple(spec.conflicts),
        exclusive=dict(spec.exclusive),
        may_request=tuple(spec.may_request),
        may_restart=tuple(spec.may_restart),
        may_act_for=tuple(spec.may_act_for),
        may_manage=tuple(spec.may_manage),
        idle=_idle(spec, profile, policy),
        update=_updating(spec, policy),
        ready=None if meta else probe(spec.ready or profile.ready, "ready", master),
        live=None if meta else probe(spec.live or profile.live, "live", master),
        interlock=None if meta else probe(interlock, "interlock", master),
        protected=protected,
        restart=spec.restart or profile.restart or "always",
        on_change=spec.on_change,
        priority=spec.priority,
        cpu=spec.resources.cpu,
        memory=spec.resources.memory,
        ros=parameters_of(source, master, diagnostics),
        **hardware(spec.driver, profile.without_hardware),
        spec=None if meta else container,
        secrets=secrets,
        defaults=tuple(sorted(path for path, names in origins.items() if names == (SHIPPED,))),
        origins={path: ", ".join(map(str, names)) for path, names in sorted(origins.items())},
        description=source.description,
        labels=source.labels,
        where=source.where("metadata", "name"),
    )
    return service, [*diagnostics, *_endless(source, service)]


def _master(container: Mapping[str, Any]) -> str:
    """The URI of the ROS 1 master that a container uses; empty for a program of ROS 2, so that none is ever asked."""
    environment = container.get("environment", {})
    words = [container.get(name) or () for name in ("entrypoint", "command")]
    text = " ".join(word if isinstance(word, str) else " ".join(map(str, word)) for word in words)
    programs = [word.rpartition("/")[2] for word in text.split()]
    if without_master(environment, str(container.get("image") or ""), programs):
        return ""
    return str(environment.get("ROS_MASTER_URI", ROS_MASTER))


def _endless(source: Source, service: Service) -> list[Diagnostic]:
    """A task that nobody can wait for."""
    if not (service.ready and service.ready.completed and service.restart == "always"):
        return []
    message = "a task that is restarted whenever it ends is never completed"
    return [Diagnostic(source.where("spec", "ready"), message, "restart: on-failure, or never")]


PREWARM = {"auto": 0.2, "off": 0.0}
"""Probabilities by name; why 0.2 is in docs/explanation/planning.md."""


def _idle(spec: Any, profile: Merged, policy: Any) -> Idle:
    """The Policy's, with what the profile and then the manifest say otherwise. What moves hardware does not begin
    before anybody asks for it unless that is said of itself."""
    first = policy.idle.model_dump(exclude_none=True) if policy and policy.idle else {}
    if spec.driver is not None:
        first.pop("prewarm", None)
    return idle_of({**first, **profile.idle, **(spec.idle.model_dump(exclude_none=True) if spec.idle else {})})


def idle_of(declared: Mapping[str, Any], otherwise: Idle = Idle()) -> Idle:
    """What fields of `idle` come to, with those that are not declared as they are otherwise."""
    found = dict(declared)
    if "escalate" in found:
        found["escalate"] = found["escalate"]["after"], found["escalate"]["action"]
    if isinstance(found.get("prewarm"), str):
        found["prewarm"] = PREWARM[found["prewarm"]]
    return replace(otherwise, **found)


ALL = "*"
"""The set of those that say `atomic: true`; no set can be called so."""


def _guard(spec: Any, policy: Any) -> tuple[bool, Any]:
    """Whether it is protected, and what must allow that its container is touched."""
    driver = spec.driver is not None
    protected = driver if spec.protected is None else spec.protected
    return protected, spec.interlock or (policy.interlock if policy and (driver or protected) else None)


def _updating(spec: Any, policy: Any) -> Updating:
    """The Policy's, with what the manifest says otherwise."""
    first = policy.updates.model_dump() if policy and policy.updates else {}
    said = {**first, **(spec.update.model_dump(exclude_none=True) if spec.update else {})}
    atomic = said.pop("atomic", False)
    return Updating(**said, atomic=atomic if isinstance(atomic, str) else ALL if atomic else "")


def policy_of(spec: Any) -> Policy:
    """The Policy of a manifest's spec."""
    budget, pressure = spec.budget, spec.pressure
    return Policy(
        spec.resync,
        spec.bulk_workers,
        Budget(**budget.model_dump()) if budget else None,
        Thresholds(**pressure.model_dump()) if pressure else None,
        dict(spec.resources),
        spec.purge_ros,
        spec.purge_shm,
        spec.removals,
        ImagePolicy(**spec.images.model_dump()) if spec.images else ImagePolicy(),
        HistoryPolicy(**spec.history.model_dump()) if spec.history else HistoryPolicy(),
    )


def probe(model: Any, role: str, master: str = "") -> Probe | None:
    """A probe as the loop asks it; `role` is ready, live or interlock."""
    if model is None:
        return None
    parts = tuple(_question(part, role, master, model) for part in getattr(model, "all", None) or ())
    if not parts:
        return _question(model, role, master, model)
    shortest = min(part.interval for part in parts)
    return replace(parts[0], kind="all", target="", interval=shortest, master="", parts=parts)


def _question(model: Any, role: str, master: str, whole: Any) -> Probe:
    """One question of a probe; `whole` says what holds for all of them."""
    kind = next(name for name in FORMS if getattr(model, name, None) is not None)
    target = getattr(model, kind)
    if kind == "tcp":
        host, _, port = str(target).rpartition(":")
        target = f"{host or '127.0.0.1'}:{port}"
    if kind == "completed":
        target = ""
    interval = model.interval or whole.interval
    if interval is None:
        interval = max(INTERVALS[role], EXEC_INTERVAL) if kind == "exec" else INTERVALS[role]
    return Probe(
        kind,
        tuple(target) if isinstance(target, list) else target,
        getattr(whole, "timeout", 30.0),
        interval,
        getattr(whole, "failures", None) or 0,
        master if kind.startswith("ros_") else "",
    )
