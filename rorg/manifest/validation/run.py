"""Runs all checks of a tree: `validate(catalog, sources)`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from rorg.manifest.documents import Source, unexpected
from rorg.manifest.validation import devices, idle, limits, mounts, networks, programs, ros1, ros2, stopping, variables
from rorg.manifest.validation.allowing import allowed
from rorg.manifest.validation.codes import CODES
from rorg.manifest.validation.robot import Check, Finding, Robot
from rorg.manifest.yaml_source import Allow
from rorg.model.catalog import Catalog
from rorg.model.diagnostics import Diagnostic, Where

FAMILIES = (networks, stopping, idle, ros1, ros2, devices, mounts, limits, programs, variables)
CHECKS: tuple[Check, ...] = tuple(check for family in FAMILIES for check in family.CHECKS)


def validate(catalog: Catalog, sources: Mapping[str, Mapping[str, Source]]) -> list[Diagnostic]:
    """Findings about a tree whose manifests are valid by themselves, without what comments allow. `sources` are the
    manifests of the Catalog, by kind and name."""
    robot = Robot(catalog, sources)
    found = [d for check in CHECKS for d in _found(check, robot)]
    return allowed(found, allows_of(sources), machine=False)


def _found(check: Check, robot: Robot) -> list[Diagnostic]:
    """Runs one check. A crash becomes a warning, so that the other checks still run."""
    try:
        return list(diagnostics(check(robot)))
    except Exception as bug:
        where = next((s.where("kind") for found in robot.sources.values() for s in found.values()), Where(""))
        return [replace(unexpected(where, bug), severity="warning")]


def diagnostics(findings: Iterable[Finding]) -> Iterator[Diagnostic]:
    """Completes findings from the table of codes."""
    for found in findings:
        code = CODES[found.code]
        remedy, severity = found.remedy or code.remedy, found.severity or code.severity
        yield Diagnostic(found.where, found.message, remedy, severity, found.code)


def allows_of(sources: Mapping[str, Mapping[str, Source]]) -> list[Allow]:
    """The comments of these files that allow warnings."""
    return [allow for found in sources.values() for source in found.values() for allow in source.document.allows]
