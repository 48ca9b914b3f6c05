"""Manifests of kinds that need no rendering, as values of the catalog: policies, standing requests, images."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

from rorg.manifest.documents import Source
from rorg.manifest.files import real
from rorg.model.catalog import Budget, Image, Policy, Request, Thresholds
from rorg.model.diagnostics import Diagnostic, Where, nearest


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
        spec.removals,
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


def image_of(source: Source) -> Image:
    """An Image, with its directories made absolute."""
    spec: Any = source.spec
    context = str(real(source.directory / spec.context)) if spec.context is not None else None
    return Image(
        source.name,
        context,
        spec.dockerfile,
        dict(spec.args),
        tuple(spec.import_) if spec.import_ else None,
        str(real(source.directory)),
        source.where("metadata", "name"),
    )


def image_problems(images: Mapping[str, Image], sources: Mapping[str, Source]) -> list[Diagnostic]:
    """Images without the Dockerfile that they name."""
    diagnostics = []
    for name, image in images.items():
        if image.context and not os.path.isfile(os.path.join(image.context, image.dockerfile)):
            where: Where = sources[name].where("spec", "context")
            diagnostics.append(Diagnostic(where, f"no {image.dockerfile} in {image.context}", "creating it"))
    return diagnostics
