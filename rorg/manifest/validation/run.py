"""All checks of a tree: `check(robot)`."""

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
    """What is wrong with a tree whose manifests are right one by one, without what comments let pass. `sources`: by
    kind and name, those that the Catalog was made of."""
    robot = Robot(catalog, sources)
    found = [d for check in CHECKS for d in _found(check, robot)]
    return allowed(found, allows_of(sources), machine=False)


def _found(check: Check, robot: Robot) -> list[Diagnostic]:
    """What one check says. What it does not understand keeps the others from nothing."""
    try:
        return list(diagnostics(check(robot)))
    except Exception as bug:
        where = next((s.where("kind") for found in robot.sources.values() for s in found.values()), Where(""))
        return [replace(unexpected(where, bug), severity="warning")]


def diagnostics(findings: Iterable[Finding]) -> Iterator[Diagnostic]:
    """With what the table says of their codes."""
    for found in findings:
        code = CODES[found.code]
        remedy, severity = found.remedy or code.remedy, found.severity or code.severity
        yield Diagnostic(found.where, found.message, remedy, severity, found.code)


def allows_of(sources: Mapping[str, Mapping[str, Source]]) -> list[Allow]:
    """What comments of these files let pass."""
    return [allow for found in sources.values() for source in found.values() for allow in source.document.allows]
