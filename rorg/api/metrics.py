"""The robot's figures in the OpenMetrics format, for Prometheus and programs like it: `GET /metrics`.

The figures are those of `rorg top`, `rorg get`, the pressure and the journal at the moment of the question; rorg keeps
no history for them. prometheus_client writes the format. It is loaded at the first question, so that a robot without
Prometheus does not pay for it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any

from fastapi import FastAPI, Header
from fastapi.responses import Response

from rorg import __version__
from rorg.api.callers import needs
from rorg.api.operations import Operations
from rorg.core.pressure import MEASURES
from rorg.model.health import Health

if TYPE_CHECKING:
    from prometheus_client import Metric

OPEN_METRICS = "application/openmetrics-text"


def add_metrics(app: FastAPI, operations: Operations) -> None:
    """Adds the route."""

    @app.get("/metrics", dependencies=[needs("read")], response_class=Response)
    def metrics(accept: Annotated[str, Header()] = OPEN_METRICS) -> Response:
        """Figures of the services, the machine and rorg itself in the OpenMetrics format; in the older Prometheus text
        format if the caller accepts only `text/plain`."""
        from prometheus_client.exposition import choose_encoder

        older = "text/plain" in accept and OPEN_METRICS not in accept
        encode, media_type = choose_encoder("" if older else OPEN_METRICS)
        return Response(encode(_Families(operations)), media_type=media_type)


class _Families:
    """What the library collects from: families of metrics, as a registry would have them."""

    def __init__(self, operations: Operations) -> None:
        self.operations = operations

    def collect(self) -> Iterator[Metric]:
        """All families, of one moment."""
        yield from _of_rorg(self.operations)
        yield from _of_services(self.operations)
        yield from _of_use(self.operations)


def _of_rorg(operations: Operations) -> Iterable[Metric]:
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily

    decision = operations.decision
    situation, pressure = decision.situation, decision.memory.pressure
    requests = [*situation.desired.catalog.requests, *decision.settled.requests]
    about = {"version": __version__, "engine": operations.engine.name, "revision": operations.tree.revision}
    yield InfoMetricFamily("rorg", "The running rorg.", about)
    for name, text, value in (
        ("engine_up", "Whether the engine answers.", situation.observed.complete),
        (
            "manifest_errors",
            "Errors in the manifests; while there are any, the last good ones count.",
            len(operations.tree.errors),
        ),
        ("suspended", "Whether rorg changes nothing for now.", bool(situation.suspended)),
        ("requests", "Requests that count, standing ones included.", len(requests)),
        ("plan_actions", "Actions that rorg would take now.", len(decision.plan.actions)),
        ("plan_waitings", "Actions that wait for something.", len(decision.plan.waitings)),
        ("in_flight", "Engine calls under way.", len(decision.memory.in_flight)),
        ("shed_services", "Services that gave way to pressure.", len(pressure.shed)),
    ):
        yield GaugeMetricFamily(f"rorg_{name}", text, float(value))
    measures = {m: pressure.in_force(m) for m in MEASURES}
    yield _gauges("rorg_pressure_measure", "Measures against pressure that are in force.", "measure", measures)
    links = {name: link.live(operations.machines.now()) for name, link in operations.machines.links.items()}
    if links:
        yield _gauges("rorg_machine_up", "Whether the link to another machine of the robot is up.", "machine", links)
    kinds = operations.journal.counts()
    events = CounterMetricFamily("rorg_events", "Events since rorg began, as in `rorg events`.", labels=["kind"])
    for kind, count in sorted(kinds.items()):
        events.add_metric([kind], count)
    yield events


def _of_services(operations: Operations) -> Iterable[Metric]:
    from prometheus_client.core import CounterMetricFamily, StateSetMetricFamily

    # Those of other machines are counted there.
    statuses = {n: s for n, s in operations.statuses().items() if s.machine in ("", operations.machines.here)}
    health = StateSetMetricFamily("rorg_service_health", "The health that `rorg get` shows.", labels=["service"])
    crashes = CounterMetricFamily("rorg_service_crashes", "Unexpected ends since rorg began.", labels=["service"])
    for name, status in statuses.items():
        health.add_metric([name], {h: h == status.health for h in Health})
        crashes.add_metric([name], status.crashes)
    wanted = {n: s.wanted for n, s in statuses.items()}
    shed = {s.service for s in operations.decision.memory.pressure.shed}
    yield health
    yield crashes
    yield _gauges("rorg_service_wanted", "Whether it must be active now.", "service", wanted)
    yield _gauges("rorg_service_shed", "Whether it gave way to pressure.", "service", {n: n in shed for n in statuses})


def _of_use(operations: Operations) -> Iterable[Metric]:
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

    used = operations.usage()
    cpu = CounterMetricFamily("rorg_service_cpu_seconds", "CPU time of its current run.", labels=["service"])
    memory = {}
    for name, use in used["services"].items():
        cpu.add_metric([name], use["cpu_seconds"])
        memory[name] = use["memory"]
    yield cpu
    yield _gauges("rorg_service_memory_bytes", "Memory that it uses.", "service", memory)
    machine = used["machine"]
    yield CounterMetricFamily(
        "rorg_machine_cpu_seconds", "CPU time of all programs since boot.", machine["cpu_seconds"]
    )
    for key, name, text in (
        ("cores", "cpu_cores", "Its cores."),
        ("memory", "memory_bytes", "Memory that is not available."),
        ("memory_total", "memory_total_bytes", "All of its memory."),
        ("cpu_some", "cpu_pressure_ratio", "Share of the last 10 s in which a program waited for the CPU."),
        ("memory_some", "memory_pressure_ratio", "Share of the last 10 s in which a program waited for memory."),
    ):
        if machine[key] is not None:
            yield GaugeMetricFamily(f"rorg_machine_{name}", text, machine[key] / (100 if name.endswith("ratio") else 1))


def _gauges(name: str, text: str, label: str, values: Mapping[str, Any]) -> Metric:
    from prometheus_client.core import GaugeMetricFamily

    family = GaugeMetricFamily(name, text, labels=[label])
    for key, value in values.items():
        family.add_metric([key], float(value))
    return family
