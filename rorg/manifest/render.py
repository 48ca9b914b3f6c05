"""From a Service manifest and its profile to the Service that the planner decides about, with its container
rendered."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

from rorg.manifest.container_files import parameters_of
from rorg.manifest.documents import Source
from rorg.manifest.driver import hardware
from rorg.manifest.probes import FORMS, Lifecycle, TopicRate
from rorg.manifest.profiles import SHIPPED, Merged
from rorg.manifest.rendered_container import container_of
from rorg.manifest.ros2 import domain_of
from rorg.model.catalog import Idle, Service, Updating
from rorg.model.diagnostics import Diagnostic, Reading
from rorg.model.policy import Budget, HistoryPolicy, ImagePolicy, NotifyTarget, Policy, Thresholds, Webhook
from rorg.model.probe import ROS_KINDS, Probe
from rorg.model.ros import graph_of_domain

ROS_MASTER = "http://localhost:11311"
"""The default address of the ROS 1 master, without ROS_MASTER_URI."""


INTERVALS = {"ready": 0.25, "live": 10.0, "interlock": 0.25}
"""Seconds between two probes if the manifest does not say. An exec costs the engine 50 ms, so its interval is
longer."""
EXEC_INTERVAL = 1.0


SAME = (
    *("always_on", "conflicts", "exclusive", "may_request", "may_restart", "may_act_for", "may_manage"),
    *("may_report_graph", "on_change", "priority"),
)
"""Fields that a Service takes from its manifest as they are."""


def render(source: Source, profile: Merged, policy: Any, engine: str = "") -> Reading[Service]:
    """Returns the service of a manifest. `profile` already includes `common`; `policy` is the Policy's spec or None;
    `engine` is the engine's name if it is known."""
    spec: Any = source.spec
    meta = spec.type == "meta"
    needs = list(spec.needs) + [n for n in profile.needs if n.service != source.name and not meta]
    container, origins, secrets = ({}, {}, ()) if meta else (yield from container_of(source, profile, engine))
    protected, interlock = _guard(spec, policy)
    domain, graph, managed = _graph(source, container)
    ros = yield from parameters_of(source, graph)
    same: dict[str, Any] = {n: tuple(v) if isinstance(v := getattr(spec, n), list) else v for n in SAME}
    service = Service(
        name=source.name,
        meta=meta,
        needs=tuple(dict.fromkeys(n.service for n in needs)),
        restarts_with=tuple(sorted({n.service for n in needs if n.restart})),
        idle=_idle(spec, profile, policy),
        update=_updating(spec, policy),
        ready=None if meta else with_managed(probe(spec.ready or profile.ready, "ready", graph), managed, graph),
        live=None if meta else probe(spec.live or profile.live, "live", graph),
        interlock=None if meta else probe(interlock, "interlock", graph),
        protected=protected,
        restart=spec.restart or profile.restart or "always",
        cpu=spec.resources.cpu,
        memory=spec.resources.memory,
        ros=ros,
        domain=domain,
        managed=managed,
        **same,
        **hardware(spec.driver, profile.without_hardware),
        spec=None if meta else container,
        secrets=secrets,
        defaults=tuple(sorted(path for path, names in origins.items() if names == (SHIPPED,))),
        origins={path: ", ".join(map(str, names)) for path, names in sorted(origins.items())},
        description=source.description,
        labels=source.labels,
        where=source.where("metadata", "name"),
    )
    yield from () if source.partial else (*_endless(source, service), *_unmanaged(source, service))
    return service


def _endless(source: Source, service: Service) -> Iterator[Diagnostic]:
    """Reports a task that can never complete, because it restarts whenever it ends."""
    if service.ready and service.ready.completed and service.restart == "always":
        message = "a task that is restarted whenever it ends is never completed"
        yield Diagnostic(source.where("spec", "ready"), message, "restart: on-failure, or never")


def _unmanaged(source: Source, service: Service) -> Iterator[Diagnostic]:
    """Reports idle actions without what they act on."""
    idle, managed = service.idle, service.managed
    where = source.where("spec", "idle", "action")
    if idle.action == "deactivate" and not managed:
        message = f"'{source.name}' has no managed nodes to deactivate"
        yield Diagnostic(where, message, "ros: {lifecycle: [/NODE]}, for a program of ROS 2")
    if idle.escalate and idle.escalate[1] == "pause" and idle.action != "deactivate":
        where = source.where("spec", "idle", "escalate", "action")
        yield Diagnostic(where, f"pause is no step after {idle.action}", "stop or remove")


def _graph(source: Source, container: Mapping[str, Any]) -> tuple[int | None, str, tuple[str, ...]]:
    """Returns the domain, the name of the graph, and the managed nodes. Only programs of ROS 2 have a domain."""
    domain, ros = domain_of(container), source.spec.ros
    if domain is None:
        return None, str(container.get("environment", {}).get("ROS_MASTER_URI", ROS_MASTER)), ()
    return domain, graph_of_domain(domain), tuple(ros.lifecycle) if ros else ()


def with_managed(ready: Probe | None, nodes: Sequence[str], graph: str) -> Probe | None:
    """Returns a readiness probe that also asks whether all managed nodes are active. A delay counts from then on, so it
    needs no question."""
    if not nodes or (ready and ready.delay is not None):
        return ready
    first = ready or Probe("all", "", interval=INTERVALS["ready"])
    asked = [p for p in first.questions if ready]
    known = {p.target for p in asked if p.kind == "lifecycle"}
    more = [(node, "active") for node in nodes if (node, "active") not in known]
    parts = [replace(first, kind="lifecycle", target=target, graph=graph, parts=()) for target in more]
    return replace(first, kind="all", target="", graph="", parts=(*asked, *parts)) if parts else ready


def _idle(spec: Any, profile: Merged, policy: Any) -> Idle:
    """Merges `idle` of the Policy, the profile and the manifest."""
    first = policy.idle.model_dump(exclude_none=True) if policy and policy.idle else {}
    return idle_of({**first, **profile.idle, **(spec.idle.model_dump(exclude_none=True) if spec.idle else {})})


def idle_of(declared: Mapping[str, Any], otherwise: Idle = Idle()) -> Idle:
    """Converts declared fields of `idle`; the others keep their values from `otherwise`."""
    settings = dict(declared)
    if "escalate" in settings:
        settings["escalate"] = settings["escalate"]["after"], settings["escalate"]["action"]
    return replace(otherwise, **settings)


ALL = "*"
"""The set of all services with `atomic: true`. No set can have this name."""


def _guard(spec: Any, policy: Any) -> tuple[bool, Any]:
    """Returns whether the service is protected, and the interlock that must allow touching its container."""
    driver = spec.driver is not None
    protected = driver if spec.protected is None else spec.protected
    return protected, spec.interlock or (policy.interlock if policy and (driver or protected) else None)


def _updating(spec: Any, policy: Any) -> Updating:
    """Merges the Policy's `updates` with the manifest's `update`. A change of a driver in use is confirmed by a person
    unless one of them says when it takes effect."""
    models = (policy.updates if policy else None, spec.update)
    said: dict[str, Any] = {"when": "now" if spec.driver is None else "confirmed"}
    said |= {k: v for model in models if model for k, v in model.model_dump(exclude_none=True).items()}
    atomic = said.pop("atomic", False)
    return Updating(**said, atomic=atomic if isinstance(atomic, str) else ALL if atomic else "")


PARTS = {"budget": Budget, "pressure": Thresholds, "images": ImagePolicy, "history": HistoryPolicy}


def policy_of(spec: Any) -> Policy:
    """Converts the spec of a Policy."""
    same = {f.name: getattr(spec, f.name) for f in fields(Policy) if f.name not in (*PARTS, "notify")}
    parts = {n: kind(**part.model_dump()) for n, kind in PARTS.items() if (part := getattr(spec, n))}
    return Policy(**same, **parts, notify=tuple(map(_target, spec.notify)))


def _target(model: Any) -> NotifyTarget:
    """Converts an entry of a Policy's `notify`."""
    return NotifyTarget(
        model.name,
        tuple(model.on),
        tuple(model.command or ()),
        Webhook(**model.webhook.model_dump()) if model.webhook else None,
        model.every,
        model.timeout,
    )


def probe(model: Any, role: str, graph: str = "") -> Probe | None:
    """Converts a probe for the loop; `role` is ready, live or interlock."""
    if model is None:
        return None
    parts = tuple(_question(part, role, graph, model) for part in getattr(model, "all", None) or ())
    if not parts:
        return _question(model, role, graph, model)
    shortest = min(part.interval for part in parts)
    return replace(parts[0], kind="all", target="", interval=shortest, graph="", parts=parts)


def _question(model: Any, role: str, graph: str, whole: Any) -> Probe:
    """Converts one question of a probe; timeout and failures come from the `whole` probe."""
    kind = next(name for name in FORMS if getattr(model, name, None) is not None)
    target = getattr(model, kind)
    if kind == "tcp":
        host, _, port = str(target).rpartition(":")
        target = f"{host or '127.0.0.1'}:{port}"
    if kind == "completed":
        target = ""
    if isinstance(target, TopicRate | Lifecycle):
        target = tuple(map(str, target.model_dump().values()))
    interval = model.interval or whole.interval
    if interval is None:
        interval = max(INTERVALS[role], EXEC_INTERVAL) if kind == "exec" else INTERVALS[role]
    return Probe(
        kind,
        tuple(target) if isinstance(target, list) else target,
        getattr(whole, "timeout", 30.0),
        interval,
        getattr(whole, "failures", None) or 0,
        graph if kind in ROS_KINDS else "",
    )
