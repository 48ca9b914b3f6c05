"""Runs all checks of a tree: `validate(catalog, sources)`. Comments allow warnings that someone has reviewed:
`# rorg: allow CODE: reason` on the line or before it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import replace

from rorg.manifest.documents import Source, unexpected
from rorg.manifest.validation import (
    anywhere,
    commands,
    devices,
    displays,
    idle,
    limits,
    mounts,
    networks,
    programs,
    ros1,
    ros2,
    stopping,
    variables,
    workspaces,
)
from rorg.manifest.validation.codes import CODES
from rorg.manifest.validation.robot import Check, Finding, Robot
from rorg.manifest.yaml_source import Allow
from rorg.model.catalog import Catalog
from rorg.model.diagnostics import Diagnostic, Where, nearest

FAMILIES = (
    *(networks, stopping, idle, ros1, ros2, devices, displays, mounts, workspaces, limits, programs, commands),
    *(variables, anywhere),
)
CHECKS: tuple[Check, ...] = tuple(check for family in FAMILIES for check in family.CHECKS)


def validate(catalog: Catalog, sources: Mapping[str, Mapping[str, Source]], contained: bool = True) -> list[Diagnostic]:
    """Findings about a tree whose manifests are valid on their own, without what comments allow. `sources` are the
    manifests of the Catalog, by kind and name. `contained`: its programs run in containers."""
    robot = Robot(catalog, sources, contained)
    findings = [d for check in CHECKS for d in _found(check, robot)]
    return list(_once(allowed(findings, allows_of(sources), machine=False)))


def _found(check: Check, robot: Robot) -> list[Diagnostic]:
    """Runs one check. A crash becomes a warning, so that the other checks still run."""
    try:
        return list(diagnostics(check(robot)))
    except Exception as bug:
        where = next((s.where("kind") for by_name in robot.sources.values() for s in by_name.values()), Where(""))
        return [replace(unexpected(where, bug), severity="warning")]


def diagnostics(findings: Iterable[Finding]) -> Iterator[Diagnostic]:
    """Completes findings from the table of codes."""
    for finding in findings:
        code = CODES[finding.code]
        remedy, severity = finding.remedy or code.remedy, finding.severity or code.severity
        yield Diagnostic(finding.where, finding.message, remedy, severity, finding.code)


def _once(findings: Iterable[Diagnostic]) -> Iterator[Diagnostic]:
    """Reduces findings of the codes that a robot shows only once to the first of each, with the number of others."""
    places: dict[str, list[Diagnostic]] = {}
    for diagnostic in sorted(findings):
        if diagnostic.code in CODES and CODES[diagnostic.code].once:
            places.setdefault(diagnostic.code, []).append(diagnostic)
        else:
            yield diagnostic
    for first, *others in places.values():
        more = f"; {len(others)} more like it, the next at {others[0].where}" if others else ""
        yield replace(first, message=f"{first.message}{more}")


def allows_of(sources: Mapping[str, Mapping[str, Source]]) -> list[Allow]:
    """The comments of these files that allow warnings."""
    return [allow for by_name in sources.values() for source in by_name.values() for allow in source.document.allows]


def allowed(findings: Iterable[Diagnostic], allows: Collection[Allow], machine: bool) -> list[Diagnostic]:
    """Returns the remaining diagnostics, and those about the comments themselves. `machine`: whether findings about
    this machine are included. Without them, a comment that allows one may look unused."""
    good: dict[tuple[str, str], list[Allow]] = {}
    for allow in allows:
        if allow.reason and allow.code in CODES:
            good.setdefault((allow.where.file, allow.code), []).append(allow)
    used: set[Allow] = set()
    left = []
    for diagnostic in findings:
        near = good.get((diagnostic.where.file, diagnostic.code), []) if diagnostic.severity != "error" else []
        by = [a for a in near if a.lines[0] <= diagnostic.where.line <= a.lines[1]]
        used.update(by)
        if not by:
            left.append(diagnostic)
    return [*left, *_wrong_comments(allows, used, machine)]


def _wrong_comments(allows: Iterable[Allow], used: Collection[Allow], machine: bool) -> Iterator[Diagnostic]:
    for allow in allows:
        code = CODES.get(allow.code)
        if code is None:
            remedy = nearest(allow.code, CODES) or "one of docs/reference/findings.md"
            message, of = f"there is no finding '{allow.code}'", "allow-unknown-code"
        elif not allow.reason:
            message = f"'{allow.code}' is allowed without a reason, so the comment has no effect"
            remedy, of = f"# rorg: allow {allow.code}: why this is right here", "allow-without-reason"
        elif allow not in used and (machine or not code.machine):
            message, remedy = f"there is no finding '{allow.code}' here", "to drop this comment"
            of = "allow-without-effect"
        else:
            continue
        yield Diagnostic(allow.where, message, remedy, "warning", of)
