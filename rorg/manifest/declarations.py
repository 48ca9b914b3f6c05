"""Manifests of kinds that need no rendering, as values of the catalog: policies and standing requests."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rorg.manifest.documents import Source
from rorg.model.catalog import Request
from rorg.model.diagnostics import Diagnostic, nearest
from rorg.model.policy import Budget, HistoryPolicy, ImagePolicy, Policy, Thresholds


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


def requests_of(
    sources: Mapping[str, Source], known: set[str], requesters: set[str]
) -> tuple[tuple[Request, ...], list[Diagnostic]]:
    """Standing requests, and names in them that mean nothing."""
    diagnostics, found = [], []
    for name, source in sources.items():
        spec: Any = source.spec
        if spec.requester not in requesters:
            diagnostics.append(
                Diagnostic(
                    source.where("spec", "requester"),
                    f"unknown requester '{spec.requester}'",
                    nearest(spec.requester, requesters),
                )
            )
        for index, service in enumerate(spec.services):
            if service not in known:
                diagnostics.append(
                    Diagnostic(
                        source.where("spec", "services", index), f"unknown service '{service}'", nearest(service, known)
                    )
                )
        found.append(
            Request(
                name,
                spec.requester,
                tuple(spec.services),
                spec.reason or "",
                standing=True,
                priority=spec.priority,
                where=source.where("metadata", "name"),
            )
        )
    return tuple(found), diagnostics
